"""Paper 003: cases, checks, figures and claims."""
