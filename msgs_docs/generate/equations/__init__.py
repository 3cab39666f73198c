"""Table of the equations of the papers: declaration, check and page."""
