"""Turn search results into a verdict: indistinguishable effects, outcome, next measurement."""
