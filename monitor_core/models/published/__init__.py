"""The papers' own forms of the drive models: reference of ``docs/equations.md``, ``docs/errata.md`` and the tests."""
