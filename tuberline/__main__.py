"""`python -m tuberline` is `tuberline`: how the supervisor starts nodes with its own interpreter."""

from tuberline.cli import main

main()
