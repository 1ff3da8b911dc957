"""The section [encoder] of a line's file: what tells the belt's travel to live cameras."""

from __future__ import annotations

from pydantic import Field, field_validator

from conveyor.config_base import Section, checked_name


class EncoderConfig(Section):
    """The encoder on the belt's shaft. Live cameras stamp each frame with the travel that it tells."""

    source: str = Field(
        description="where its count comes from: serial:/dev/ttyACM0?baud=115200 or tcp://host:port (a line of text "
        "each time), counter:/sys/bus/counter/devices/counter0/count0 (Linux), simulated:?speed_mps=0.4"
    )
    metres_per_pulse: float = Field(
        ge=-1, le=1, description="belt that passes in one count; below 0 where it counts down while the belt runs on"
    )
    bits: int = Field(32, ge=8, le=64, description="of the counter: where it is full it begins at 0 again")
    name: str = Field("encoder", description="the encoder's name on the line")

    @field_validator("metres_per_pulse")
    @classmethod
    def _moves(cls, metres: float) -> float:
        if abs(metres) < 1e-7:
            raise ValueError("a pulse is some belt: 0.0005 is half a millimetre")
        return metres

    @field_validator("name")
    @classmethod
    def _name(cls, name: str) -> str:
        return checked_name(name, "encoder")
