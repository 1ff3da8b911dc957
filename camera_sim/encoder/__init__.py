"""The encoder on the belt's shaft as a node: how far the belt has moved, for cameras that do not know it themselves."""
