"""`ecology check`: check a scenario against the contract."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from ecology import faults
from ecology.lab.cli.options import NAME_OR_PATH, announces_compiling

ORDER = 3
CHECKED = 200  # ticks of a life


@announces_compiling
def command(
    scenario: Annotated[str, typer.Argument(metavar="SCENARIO", help=NAME_OR_PATH)],
    ticks: Annotated[int, typer.Option(min=1, help="Length of each test run.")] = CHECKED,
) -> None:
    """Check a scenario against the contract; exit with code 1 if it fails."""
    from ecology import contract, scenarios

    broken = 0
    for holds, error in contract.check(scenarios.load(scenario), ticks):
        fault = None if error is None else faults.user_fault(error)
        if fault is not None:
            raise fault from error
        print(f"{'FAIL' if error else 'pass'}  {holds}", flush=True)
        if error:
            broken += 1
            print(f"      {contract.reason(error)}")
    if broken:
        print(f"{scenario} fails {broken} of {len(contract.CHECKS)} checks of the contract.", file=sys.stderr)
        raise typer.Exit(1)
    print(f"{scenario} satisfies the contract: {len(contract.CHECKS)} checks over {ticks} ticks.")
