"""Prediction less measurement, one module for each kind of datum."""
