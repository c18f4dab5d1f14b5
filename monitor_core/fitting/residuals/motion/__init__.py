"""Compare the force records of a moving axis with a rigid-body model."""
