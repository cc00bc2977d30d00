"""`python -m posegaussian`: the command, where its folder is not on the PATH."""

from posegaussian.dags.cli.app import main

if __name__ == "__main__":
    main()
