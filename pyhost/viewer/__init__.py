"""The page on which a map, its samples, the sphere and the error answer to the hand: a server on this machine.

:mod:`.engine` computes what the page shows, :mod:`.messages` is what they say to each other, :mod:`.server` lets in
nobody but who has the address, and ``static/`` holds the page. Needs the extra ``[view]``.
"""
