"""An interactive page that shows a map, its samples, the sphere and the error, and the local server behind it.

:mod:`.engine` computes what the page shows, :mod:`.messages` defines the messages between them, :mod:`.server` serves
the page, :mod:`.gate` admits only those who know its address, and ``static/`` holds its files. Needs the extra
``[view]``.
"""
