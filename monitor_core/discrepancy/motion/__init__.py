"""Force records of a moving axis beside a rigid-body model of its motion."""
