"""Parts that several scenarios share; no scenarios themselves."""
