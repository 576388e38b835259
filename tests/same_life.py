"""Print a digest of whole lives, learners included: the same on every processor. `python same_life.py [LIFE ...]`."""

import sys

from ecology.lab.certificate.reference import LEARNER, SCENARIO, TICKS
from ecology.lab.certificate.reference import digest as digest_of

LIVES = {  # scenario, its settings, learner and ticks
    "paper": (SCENARIO, {}, LEARNER, TICKS),
    "commons": ("commons", {"n": 300, "walls": True}, "lean", 60),
    "predator_prey": ("predator_prey", {}, "hjb", 150),
    "seasons": ("seasons", {}, "algorithm1", 300),
    "well_mixed": ("well_mixed", {}, "random", 300),
}


def digest(life: str) -> str:
    """Return a digest of one of LIVES."""
    return digest_of(*LIVES[life])


if __name__ == "__main__":
    for each in sys.argv[1:] or LIVES:
        print(each, digest(each), flush=True)
