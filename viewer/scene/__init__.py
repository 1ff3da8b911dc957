"""What is shown of a line, as plain values: messages in, primitives out; how a program draws them is not known here."""
