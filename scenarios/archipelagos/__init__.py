"""Archipelagos: a file in this folder that defines `build` is an archipelago; there is no registry."""
