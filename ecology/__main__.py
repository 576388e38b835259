"""`python -m ecology` is the command `ecology`."""

import runpy

runpy.run_module("ecology.scenarios.cli", run_name="__main__", alter_sys=True)  # run: the world knows no scenario
