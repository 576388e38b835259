"""Observers, which watch a run and change nothing: recorder, rerun, picture."""
