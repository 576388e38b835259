"""`python -m ecology.lab.cli` is the command `ecology`."""

from ecology.lab.cli import main

if __name__ == "__main__":
    main()
