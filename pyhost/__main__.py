"""``python -m lightdome``: the console program ``lightdome``."""

from .commands.program import main

if __name__ == "__main__":
    main()
