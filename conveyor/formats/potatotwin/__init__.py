"""The 3DPotatoTwin folder: `layout` says what lies where, once, for replay, training and `weigh`."""
