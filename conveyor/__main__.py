"""`python -m conveyor` is `tuberline`: how the supervisor starts nodes with its own interpreter."""

from conveyor.cli import main

main()
