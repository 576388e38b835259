"""Where the f/J learner computes: the CPU by compiled kernels, other devices by torch, and a plain reference.

Each is a folder of the same chapters with the same function names in the same order:

- `encoding`: drive and inputs of the networks,
- `networks`: f and J at given states,
- `first_order`: dJ/dzeta . f, which only `algorithm1` needs,
- `scores`: the HJB score of the open movements,
- `lookahead`: the same over several movements, f corrected by its latest errors,
- `learning`: batches and losses,
- `adam`: the optimiser,
- `update`: all of it, once for every agent,
- `device`: what the learner calls.
"""

from __future__ import annotations

import importlib
import re

from ecology.agents.hjb.devices.base import Device
from ecology.agents.hjb.devices.records import Encoding
from ecology.errors import EcologyError

NAMES = r"cpu|plain|mps|cuda(:\d+)?"

__all__ = ["Device", "check_device", "make"]


def check_device(name: str) -> None:
    """Raise EcologyError if `name` is not the name of a device, available or not."""
    if not re.fullmatch(NAMES, name):
        raise EcologyError(f"device is cpu, plain, cuda, cuda:NUMBER or mps, got {name!r}.")


def make(name: str, encoding: Encoding, n: int) -> Device:
    """Return the device `name` for n agents. Raises EcologyError if this machine does not have it."""
    check_device(name)
    if name == "cpu":
        return importlib.import_module("ecology.agents.hjb.devices.cpu.device").Cpu(encoding, n)
    if name == "plain":
        return importlib.import_module("ecology.agents.hjb.devices.plain.device").Plain(encoding)
    torch = importlib.import_module("ecology.agents.hjb.devices.torch.device")  # slow to load
    available = torch.available()
    if name not in available:
        raise EcologyError(f"there is no device {name!r} here; there is {', '.join(available)}. Pass one by --device.")
    return torch.Torch(encoding, name)
