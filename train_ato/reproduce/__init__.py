"""The claims of the five papers beside what is measured here."""
