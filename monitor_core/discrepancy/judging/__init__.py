"""What may be said: effects that cannot be told apart, the outcome, and the measurement that would decide."""
