"""Panels of the viewer, a file each: what it samples in a run, how it is drawn, and its views. See base.py."""
