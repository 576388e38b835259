"""The f/J learner: `learner` is the algorithm, `settings` what can be set, `devices` where it computes."""

from ecology.agents.hjb.learner import HJB
from ecology.agents.hjb.settings import ALGORITHM1, CROWD, LEAN, HJBSettings

__all__ = ["ALGORITHM1", "CROWD", "HJB", "LEAN", "HJBSettings"]
