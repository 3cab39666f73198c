"""Scenario files: models, interventions, recorded changes, shipped scenarios."""
