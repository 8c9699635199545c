"""The web page of ``shape-obs tune``: what it shows and changes, and its server.

``session`` and ``engine`` need no browser: the settings with undo, and the thread that reads frames and finds the
shapes in them. ``server`` and the files of ``page`` need NiceGUI (extra ``tune``).
"""
