"""`tuberline completion`: tab completion for the shell."""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Literal

ZSH_TAIL = """
if [ "$funcstack[1]" = "_cyclopts_tuberline" ]; then
  _cyclopts_tuberline "$@"
else
  (( $+functions[compdef] )) || { autoload -Uz compinit && compinit; }
  compdef _cyclopts_tuberline tuberline
fi
"""
"""Read by `source`, a function that no one registers completes nothing; found in fpath, it is called at once."""


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
    script = app.generate_completion(shell=shell) + (ZSH_TAIL if shell == "zsh" else "")
    if not install:
        sys.stdout.write(script)
        return
    path = app.install_completion(shell=shell, add_to_startup=shell == "bash")
    path.write_text(script, encoding="utf-8")
    if shell == "zsh":
        _source_in(Path(os.environ.get("ZDOTDIR", Path.home())) / ".zshrc", path)
    sys.stdout.write(f"{path}: start a new {shell} to use it\n")


def _source_in(rc: Path, script: Path) -> None:
    """Have a shell read the script whenever it starts."""
    line = f'[ -f "{script}" ] && . "{script}"'
    text = rc.read_text(encoding="utf-8") if rc.is_file() else ""
    if line not in text:
        rc.write_text(f"{text}{'' if text.endswith(chr(10)) or not text else chr(10)}{line}\n", encoding="utf-8")
