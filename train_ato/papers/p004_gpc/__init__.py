"""Paper 004: cases, checks, figures and claims."""
