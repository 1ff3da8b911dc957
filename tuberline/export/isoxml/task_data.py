"""TASKDATA of a field's map: one task per run with its time log, the totals of the run, and the field and the varieties
that its loads name.

Second by second the log has where the share was, the yield per area (DDI 84, mg/m2), the mass and count per time
(87, mg/s; 88, 0.001/s) and the working width (67, mm). Seconds that the map leaves out have a place and no yield.
Totals and mass per time are the machine's own, as its loads have them; yields are on the one scale of the map.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from conveyor import __version__
from conveyor.typed_names import as_first_given, name_key
from tuberline.export.isoxml.time_log import LoggedValue, LogRecord, header_xml, pack_records
from tuberline.maps.field import FieldPlaces, MachineShare

DEVICE, ELEMENT = "DVC-1", "DET-1"
PER_AREA, PER_TIME, COUNT_PER_TIME, WIDTH = (LoggedValue(ddi, ELEMENT) for ddi in (84, 87, 88, 67))
COLUMNS = (PER_AREA, PER_TIME, COUNT_PER_TIME, WIDTH)
TOTAL_MASS, TOTAL_COUNT = 90, 91
CROP = "Potatoes"
MOST_TEXT = 32
"""Characters of a designator."""
_NAMES = {
    84: "Yield per area",
    87: "Mass flow",
    88: "Count flow",
    67: "Working width",
    90: "Total mass",
    91: "Total count",
}


def write_taskdata(field: FieldPlaces, path: Path, *, about: dict[str, Any]) -> int:
    """A zip with TASKDATA/TASKDATA.XML and its time logs, version 4; returns how many records they hold."""
    logs = [log_of(field, share) for share in field.shares]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("TASKDATA/TASKDATA.XML", task_xml(field, about))
        for n, log in enumerate(logs, start=1):
            archive.writestr(f"TASKDATA/TLG{n:05d}.XML", header_xml(COLUMNS))
            archive.writestr(f"TASKDATA/TLG{n:05d}.BIN", pack_records(log, COLUMNS))
    return sum(map(len, logs))


def log_of(field: FieldPlaces, share: MachineShare) -> list[LogRecord]:
    """One record per second whose place is known."""
    points = share.points
    placed = np.isfinite(points.xy_m).all(axis=1)
    lat, lon = field.plane.to_degrees(np.nan_to_num(points.xy_m))
    width_mm = round(share.width_m * 1000)
    t_ha, kg = points.t_ha, points.kg / share.factor
    records = []
    for i in np.flatnonzero(placed):
        values = {WIDTH: width_mm, PER_TIME: round(kg[i] * 1e6), COUNT_PER_TIME: int(points.count[i]) * 1000}
        if points.used[i] and np.isfinite(t_ha[i]):
            values[PER_AREA] = round(t_ha[i] * 1e5)  # a tonne per hectare is 100,000 mg/m2
        at = datetime.fromtimestamp(round(points.time_s[i], 3), UTC)
        records.append(LogRecord(at, float(lat[i]), float(lon[i]), values))
    return records


def task_xml(field: FieldPlaces, about: dict[str, Any]) -> bytes:
    """TASKDATA.XML."""
    root = ElementTree.Element(
        "ISO11783_TaskData",
        VersionMajor="4",
        VersionMinor="3",
        ManagementSoftwareManufacturer="Tuberline",
        ManagementSoftwareVersion=__version__,
        TaskControllerManufacturer="Tuberline",
        TaskControllerVersion=__version__,
        DataTransferOrigin="2",
    )
    _device(root)
    ElementTree.SubElement(root, "PDT", A="PDT-1", B=CROP)
    partfields = _partfields(root, [pair for told in about["runs"] for pair in told["grown"]])
    for n, share in enumerate(field.shares, start=1):
        _task(root, n, share, about["runs"][n - 1], partfields)
    ElementTree.indent(root)
    return b'<?xml version="1.0" encoding="UTF-8"?>\n' + ElementTree.tostring(root) + b"\n"


def _device(root: ElementTree.Element) -> None:
    # Structure and localization labels and the working-set name are a terminal's own; zeros say that there is none.
    device = ElementTree.SubElement(
        root,
        "DVC",
        A=DEVICE,
        B="Tuberline",
        C=__version__[:MOST_TEXT],
        D="A000000000000000",
        F="00000000000000",
        G="FF000000000000",
    )
    element = ElementTree.SubElement(device, "DET", A=ELEMENT, B="1", C="1", D="Harvester", E="0", F="0")
    for n, ddi in enumerate((*(value.ddi for value in COLUMNS), TOTAL_MASS, TOTAL_COUNT), start=2):
        ElementTree.SubElement(element, "DOR", A=str(n))
        trigger = "16" if ddi in (TOTAL_MASS, TOTAL_COUNT) else "1"
        ElementTree.SubElement(device, "DPD", A=str(n), B=f"{ddi:04X}", C="0", D=trigger, E=_NAMES[ddi])


def _partfields(root: ElementTree.Element, grown: Sequence[Mapping[str, str]]) -> dict[str, str]:
    """Crop, varieties and fields that the loads name; ids of the fields by the keys of their names. Of a field with
    several varieties none is said to be its own; how large a field is no load says (0).
    """
    varieties = as_first_given(pair["variety"] for pair in grown if pair["variety"])
    fields = as_first_given(pair["field"] for pair in grown if pair["field"])
    lifted: dict[str, set[str]] = {key: set() for key in fields}
    for pair in grown:
        if pair["field"]:
            lifted[name_key(pair["field"])].add(name_key(pair["variety"]))
    if not grown:
        return {}
    crop = ElementTree.SubElement(root, "CTP", A="CTP-1", B=CROP)
    variety_ids = {key: f"CVT-{n}" for n, key in enumerate(varieties, start=1)}
    for key, variety in varieties.items():
        ElementTree.SubElement(crop, "CVT", A=variety_ids[key], B=variety[:MOST_TEXT])
    ids = {key: f"PFD-{n}" for n, key in enumerate(fields, start=1)}
    for key, name in fields.items():
        of_field = ElementTree.SubElement(root, "PFD", A=ids[key], C=name[:MOST_TEXT], D="0", G="CTP-1")
        if len(lifted[key]) == 1 and (variety_id := variety_ids.get(*lifted[key])):
            of_field.set("H", variety_id)
    return ids


def _task(
    root: ElementTree.Element, n: int, share: MachineShare, told: dict[str, Any], partfields: Mapping[str, str]
) -> None:
    task = ElementTree.SubElement(root, "TSK", A=f"TSK-{n}", B=share.run[:MOST_TEXT], G="4")
    fields = list(as_first_given(pair["field"] for pair in told["grown"] if pair["field"]))
    if len(fields) == 1:  # a task is of one field at most
        task.set("E", partfields[fields[0]])
    start, stop = (datetime.fromtimestamp(at, UTC) for at in (share.points.time_s[0], share.points.time_s[-1]))
    time = ElementTree.SubElement(
        task, "TIM", A=_iso(start), B=_iso(stop), C=str(round((stop - start).total_seconds())), D="4"
    )
    ElementTree.SubElement(time, "DLV", A=f"{TOTAL_MASS:04X}", B=str(round(share.kg)), C=ELEMENT)
    ElementTree.SubElement(time, "DLV", A=f"{TOTAL_COUNT:04X}", B=str(share.tubers), C=ELEMENT)
    ElementTree.SubElement(task, "TLG", A=f"TLG{n:05d}", C="1")
    ElementTree.SubElement(task, "DAN", A="A000000000000000", C=DEVICE)
    coverage = told.get("coverage")
    seen = "" if coverage is None else f", {100 * coverage:.0f} % of the belt seen"
    scaled = "" if share.factor == 1 else f", yields times {share.factor:.3f} to meet the other machines"
    several = f", of the fields {', '.join(fields)}" if len(fields) > 1 else ""
    by = f"weights {'+'.join(told['weights']) or 'unknown'}, calibrated by {told['calibrated_by']}"
    text = f"{by}{seen}{scaled}{several}"
    task.append(ElementTree.Comment(f" {re.sub('-{2,}', '-', text)} "))  # a comment holds no two hyphens


def _iso(at: datetime) -> str:
    return at.strftime("%Y-%m-%dT%H:%M:%SZ")
