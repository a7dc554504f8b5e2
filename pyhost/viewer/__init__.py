"""The page that shows a map, its samples, the sphere and the error as the user turns the light.

:mod:`.engine` computes what the page shows, :mod:`.messages` defines the messages between them, :mod:`.server` serves
only those who have the address, and ``static/`` holds the page. Needs the extra ``[view]``.
"""
