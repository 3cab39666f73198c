"""Running, opening and comparing runs: the code of ``import train_ato``, ``train-ato run`` and ``compare``."""
