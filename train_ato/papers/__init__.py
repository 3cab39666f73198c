"""Reproduction of the claims of five papers."""

import pkgutil


def paper_packages() -> dict[str, str]:
    """Return the package of every paper by number: ``p000_heavy_haul`` ..."""
    names = (module.name for module in pkgutil.iter_modules(__path__) if module.ispkg)
    return {name[1:4]: name for name in sorted(names)}
