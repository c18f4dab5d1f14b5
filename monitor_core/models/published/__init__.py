"""The papers' own forms of the drive models: what equations, errata (``docs/reference``) and tests refer to."""
