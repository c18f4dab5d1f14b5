"""An axis that does not know the product: the independent truth of the end-to-end tests.

A finite-element axial-torsional chain runs in the time domain under a servo, with friction, sensors and their noise. It
shares no formula with the product: it imports nothing of ``monitor_core`` but the records that carry samples
(``monitor_core.recording``), and never its models, identification, discrepancy or any estimator.
"""
