"""`tuberline completion`: tab completion for the shell."""

from __future__ import annotations

import sys
from typing import Literal


def completion(shell: Literal["bash", "zsh", "fish"], /, *, install: bool = False) -> None:
    """Print a script that completes commands and options on the tab key, or put it where the shell finds it.

    For this shell alone: source <(tuberline completion bash), and in fish: tuberline completion fish | source

    Parameters
    ----------
    shell
        Which shell.
    install
        Write the script into this user's folder for completions, and for zsh and bash a line into the shell's rc file.
    """
    from tuberline.cli.commands import build_app

    app = build_app(all_listed=True)
    if install:
        sys.stdout.write(f"{app.install_completion(shell=shell)}: start a new {shell} to use it\n")
    else:
        sys.stdout.write(app.generate_completion(shell=shell))
