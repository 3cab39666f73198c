"""The operational speed profile: knots over time, and the ways to write one down."""
