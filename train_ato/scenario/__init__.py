"""Scenario files: models, interventions, recorded changes, shipped scenarios, and the run prepared from them."""
