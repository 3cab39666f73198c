"""Paper 002: cases, checks, figures and claims."""
