"""`python -m physconvex`, the same as the console script."""

from physconvex.cli import main

if __name__ == "__main__":
    main()
