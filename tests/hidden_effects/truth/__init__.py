"""The independent truth: plants in time, every effect built in as a mechanism. Nothing here imports the product."""
