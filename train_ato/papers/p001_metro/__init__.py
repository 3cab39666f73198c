"""Paper 001: cases, checks, figures and claims."""
