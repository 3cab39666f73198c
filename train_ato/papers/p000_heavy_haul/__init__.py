"""Paper 000: cases, checks, figures and claims."""
