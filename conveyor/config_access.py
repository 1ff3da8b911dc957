"""The section [access] of a line's file."""

from __future__ import annotations

from pydantic import Field, field_validator

from conveyor.config_base import Section, checked_name


class AccessConfig(Section):
    """Who may connect to this line's router besides its own cameras, segmenters, r1..rN and aggregator.

    Names are those in the certificates; '*' is the certificate that all of a role share. A name taken off the list is
    locked out when the router starts again.
    """

    enabled: bool = Field(False, description="each node may do what the topic table says, and nothing else; needs TLS")
    regressors: tuple[str, ...] = Field((), description="regressors on other machines")
    viewers: tuple[str, ...] = Field(("*",), description="who may see frames, views, weights, totals and health")
    recorders: tuple[str, ...] = Field(("*",), description="who may record the frames of all cameras")
    operators: tuple[str, ...] = Field(("*",), description="status, top, doctor, metrics, the operator's page")
    keepers: tuple[str, ...] = Field(("*",), description="who may give new weights to running regressors")
    loaders: tuple[str, ...] = Field(("*",), description="who may start and end loads: `tuberline load`, page, sensor")
    encoders: tuple[str, ...] = Field((), description="encoders beside the line's own: who may tell the belt's travel")
    gnss: tuple[str, ...] = Field((), description="receivers beside the line's own: who may tell where the machine is")

    @field_validator("regressors", "viewers", "recorders", "operators", "keepers", "loaders", "encoders", "gnss")
    @classmethod
    def _names(cls, names: tuple[str, ...]) -> tuple[str, ...]:
        for name in names:
            if name != "*":
                checked_name(name, "node")
        return names
