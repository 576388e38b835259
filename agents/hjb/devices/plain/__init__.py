"""The plain reference: one agent after another by torch's own layers and gradients, see `device`."""
