"""What is wrong with a line or the machine under it, and how to fix it."""

from tuberline.doctor.finding import Finding, Level, worst

__all__ = ["Finding", "Level", "worst"]
