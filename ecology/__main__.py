"""`python -m ecology` is the command `ecology`."""

import runpy

runpy.run_module("scenarios.cli", run_name="__main__", alter_sys=True)  # run, not imported: the world knows no scenario
