"""Applications on recorded or running trains: report, view, replay, CSV import, law checks."""
