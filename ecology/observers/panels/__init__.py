"""Panels of the viewer, one file each: its samples of a run, how it is drawn, and its views. See base.py."""
