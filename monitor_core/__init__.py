"""The science of preload monitoring: pure functions on frozen records.

No file (``recordings`` aside), clock, environment, log, web or database. The same code runs live, in replay and in
tests. The modules stand in the order in which a window flows through them; see ``docs/architecture.md``.
"""
