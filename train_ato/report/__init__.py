"""Pictures of recorded runs: one page that works without a network, and figures for print.

Reading (``recording``), working out (``delays``, ``events``, ``digest``), thinning (``thin``) and drawing (``style``,
``panels``, ``page``, ``plates``) are apart.  ``quantities`` says once in which words, unit and colour a quantity is
shown; ``style`` and ``panels`` take arrays and give Bokeh figures, for this page and for any other.
"""
