"""A GNSS receiver on a line: sentences of several talkers, a receiver that goes and comes, and what is kept."""

from __future__ import annotations

import resource
import signal
import socket
import subprocess
import sys
import threading
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from pathlib import Path

import pytest

pytest.importorskip("pynmeagps")

from camera_sim.gnss.receivers import open_receiver
from camera_sim.gnss.simulated import simulated_drive
from conveyor.config import AggregatorConfig, LineConfig, LinkConfig, dump_toml
from conveyor.errors import PERMANENT, ConfigError, DeviceError, InputError, StorageError
from conveyor.formats.nmea import NmeaFixes
from conveyor.formats.positions import COLUMNS, PositionsWriter, read_positions
from conveyor.geometry import EARTH_M_PER_DEG
from conveyor.observer import Observer
from tests.conftest import wait_until

START = datetime(2026, 9, 14, 23, 59, 57, tzinfo=UTC)


def sentence(body: str) -> bytes:
    checksum = 0
    for byte in body.encode():
        checksum ^= byte
    return f"${body}*{checksum:02X}\r\n".encode()


def rmc(clock: str, date: str, talker: str = "GN") -> bytes:
    return sentence(f"{talker}RMC,{clock},A,5242.0000,N,00545.0000,E,2.7,0.0,{date},,,A")


def gga(clock: str, *, lat: str = "5242.0000", quality: int = 4, talker: str = "GN") -> bytes:
    place = f"{lat},N,00545.0000,E" if quality else ",,,"
    return sentence(f"{talker}GGA,{clock},{place},{quality},14,0.7,3.1,M,45.0,M,,")


def test_sentences_become_positions_over_midnight_and_without_a_fix() -> None:
    fixes = NmeaFixes()
    assert fixes.push(gga("235957.00")) is None, "there is no date yet"
    assert fixes.push(rmc("235957.00", "140926")) is None
    found = [
        fixes.push(gga(clock, quality=q, talker=t)) for clock, q, t in [("235958.00", 4, "GN"), ("000000.20", 0, "GP")]
    ]
    assert found[0] is not None
    assert found[1] is not None
    assert found[0].fix_ns == (int(START.timestamp()) + 1) * 10**9
    assert (found[0].lat_deg, found[0].lon_deg, found[0].quality, found[0].satellites) == (52.7, 5.75, 4, 14)
    assert found[1].fix_ns - found[0].fix_ns == 2_200_000_000, "midnight lies between"
    assert (found[1].quality, found[1].lat_deg) == (0, 0.0)
    bad = gga("000001.00")[:-5] + b"00\r\n"
    for line in (
        b"garbage\n",
        bad,
        b"$GNGGA,,,\r\n",
        b"\x00\xff" * 600,
        sentence("GNGGA,xx,5242,N,1,E,4,1,1,1,M,1,M,,"),
    ):
        assert fixes.push(line) is None
    assert fixes.refused.total() == 6, fixes.refused


def test_positions_are_kept_row_by_row_and_damage_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "positions.csv"
    with PositionsWriter(path) as file:
        for second in range(3):
            file.write((10**18 + second * 10**9, 10**18, 52.7, 5.75 + second * 1e-5, 4, 0.7, 14))
    whole = path.read_bytes()
    path.write_bytes(whole + b"3,1000000003000000000,10000")  # the power went
    assert [place.time_ns for place in read_positions(path)] == [10**18 + n * 10**9 for n in range(3)]
    with PositionsWriter(path) as file:
        assert file.rows == 3
        file.write((10**18 + 3 * 10**9, 10**18, 52.7, 5.75, 0, None, 0))
    assert [place.quality for place in read_positions(path)] == [4, 4, 4, 0]
    assert path.read_bytes().startswith(",".join(COLUMNS).encode())
    path.write_bytes(path.read_bytes().replace(b"52.7,5.75001", b"52.7,5.75091"))
    with pytest.raises(InputError, match="line 3 is damaged"):
        read_positions(path)
    (tmp_path / "file").write_text("")
    with pytest.raises(StorageError), PositionsWriter(tmp_path / "file" / "positions.csv"):
        pass


def test_a_full_disk_is_told_by_name_and_ends_with_a_whole_row(tmp_path: Path) -> None:
    """Closing tried the row again, and what was told was an error without the file's name."""
    path = tmp_path / "positions.csv"

    def fill() -> None:
        with PositionsWriter(path) as file:
            while file.rows < 10:
                file.write((10**18, 10**18, 52.7, 5.75, 4, 0.7, 14))

    limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (300, limits[1]))
    try:
        with pytest.raises(StorageError, match=r"positions\.csv: File too large"):
            fill()
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, limits)
    with PositionsWriter(path) as file:
        assert 1 < file.rows < 10
    assert path.read_bytes().endswith(b"\n")


def test_a_date_that_no_month_has_is_counted_and_not_taken() -> None:
    fixes = NmeaFixes()
    assert fixes.push(sentence("GPZDA,100000.00,31,02,2026,00,00")) is None
    assert fixes.push(gga("100000.00")) is None
    assert fixes.refused == {"damaged": 1, "no date yet": 1}


def test_tracks_of_others_are_read(tmp_path: Path) -> None:
    point = '<trkpt lat="52.7" lon="5.75"><time>{}</time></trkpt>'
    gpx = f'<gpx xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>{point}'
    files = {
        "a.gpx": (gpx.format("2026-09-14T10:00:00Z") + "</trkseg></trk></gpx>").encode(),
        "b.csv": b"time,latitude,longitude\n2026-09-14T10:00:00+00:00,52.7,5.75\n",
        "c.csv": b"timestamp,lat,long\n1789380000,52.7,5.75\n",
        "c2.csv": b"Time;Latitude;Longitude;\r\n1789380000;52,7;5.75;\r\n",
        "c3.csv": b'time_s,lat,lon\n"1789380000,0","52,7","5,75"\n',
        "c4.tsv": b"utc\tlat\tlon\n2026-09-14T12:00:00,000+02:00\t52,7\t5,75\n",
        "d.nmea": rmc("100000.00", "140926") + gga("100000.00"),
    }
    for name, data in files.items():
        (tmp_path / name).write_bytes(data)
        (place,) = read_positions(tmp_path / name)
        assert (place.time_ns, place.lat_deg, place.lon_deg) == (1789380000 * 10**9, 52.7, 5.75), name
    for text, told in (
        ("a,b\n1,2\n", "needed are a time"),
        ("time,lat,lon\nnoon,1,2\n", "line 2: its time is 'noon'; give Unix seconds, or ISO 8601"),
        ("time,lat,lon\n1789380000,52,7,5,75\n", "line 2: it has more values .* decimal commas need ; between them"),
        ("time;lat;lon\n1789380000;52,7\n", "line 2: it has fewer values than the header has names: time, lat, lon"),
        ("time;lat;lon\n1789380000;1.052,7;5\n", "line 2: '1.052,7' is no number; give one with a decimal point or"),
        ("<gpx>", "no GPX"),
        ("timestamp,lat,lon\n1789380000000,52.7,5.75\n", "line 2: its time lies 1.78938e\\+12 s after 1970"),
        ("time,lat,lon\ninf,52.7,5.75\n", "line 2"),
        ("time,lat,lon\n1789380000,5230.123,5.75\n", "line 2: its latitude is 5230.12"),
        ("time,lat,lon,quality\n1789380000,52.7,5.75,300\n", "line 2: its quality is 300"),
    ):
        (tmp_path / "bad").write_text(text)
        with pytest.raises(InputError, match=told):
            read_positions(tmp_path / "bad")
    (tmp_path / "nan").write_text("time,lat,lon\n1789380000,nan,nan\n")
    assert [place.quality for place in read_positions(tmp_path / "nan")] == [0], "a logger without a fix yet"


def test_a_table_with_the_newest_first_is_read_from_its_end(tmp_path: Path) -> None:
    """All but one of its positions were left out: time went back. A clock that is set back once turns nothing."""
    rows = [f"{1789380000 + n},52.7,5.75" for n in range(40)]
    for name, lines in (("down.csv", rows[::-1]), ("up.csv", rows), ("set.csv", rows[20:] + rows[:20])):
        (tmp_path / name).write_text("\n".join(["time,lat,lon", *lines]) + "\n")
        found = [place.time_ns // 10**9 - 1789380000 for place in read_positions(tmp_path / name)]
        assert found == ([*range(20, 40), *range(20)] if name == "set.csv" else list(range(40))), name


def test_positions_of_a_log_that_are_not_taken_are_counted(tmp_path: Path) -> None:
    """A map said nothing of sentences with wrong checksums, and of a log without dates that it held no position."""
    log, refused = tmp_path / "log.nmea", Counter[str]()
    whole = rmc("100000.00", "140926") + gga("100000.00")
    log.write_bytes(gga("095959.00") + whole + gga("100001.00").replace(b"*", b"1*") + b"$GPGSV,1,1,00*00\r\n")
    assert len(read_positions(log, refused=refused)) == 1
    assert refused == {"with a wrong checksum": 1, "before any date, which RMC or ZDA tell": 1}
    for data, told in ((gga("100000.00"), "no position: 1 before any date"), (whole[:40] + b"\r\n", "no sentence GGA")):
        log.write_bytes(data)
        with pytest.raises(InputError, match=told):
            read_positions(log)


def test_a_source_that_is_none_or_not_there_is_told() -> None:
    with pytest.raises(ConfigError, match="allowed are serial:"):
        open_receiver("bluetooth:gps", wait=lambda s: False)
    with pytest.raises(DeviceError, match="cannot be opened"):
        open_receiver("serial:/dev/no-such-port", wait=lambda s: False)


def test_a_recorded_file_that_is_stopped_has_not_ended(tmp_path: Path) -> None:
    """A stopped node told that its positions had ended, in the middle of them."""
    path = tmp_path / "drive.nmea"
    path.write_bytes(rmc("100000.00", "140926") + gga("100000.00") + gga("100030.00"))
    source = open_receiver(f"file:{path}", wait=lambda s: True)
    assert [source.read() is not None for _ in range(3)] == [True, True, False]
    with pytest.raises(EOFError):
        source.read()


def test_a_simulated_machine_drives_row_by_row() -> None:
    drive = simulated_drive("row_m=70&width_m=3&turn_s=10&hz=5")
    north_m = [round((drive.at(s)[0] - drive.lat) * EARTH_M_PER_DEG, 3) for s in (0, 25, 50, 60, 85, 110)]
    assert north_m == [0, 35, 70, 70, 35, 0], "up at 1.4 m/s, 10 s for the turn, down"
    aside = [drive.at(s)[1] - drive.lon for s in (50, 60, 110, 120)]
    assert aside == pytest.approx([0, aside[1], aside[1], 2 * aside[1]])
    waited: list[float] = []
    source = open_receiver("simulated:?row_m=70&hz=5", wait=lambda s: bool(waited.append(s)))
    fixes = NmeaFixes()
    found = [fix for _ in range(4) if (fix := fixes.push(source.read() or b"")) is not None]
    assert [(fix.quality, round(fix.lon_deg, 7)) for fix in found] == [(8, 5.75)] * 2
    assert (found[1].lat_deg - found[0].lat_deg) * EARTH_M_PER_DEG == pytest.approx(0.28, abs=0.01)
    assert waited == [pytest.approx(0.2, abs=0.1)]
    for wrong in ("rows=3", "hz=0", "lat=north"):
        with pytest.raises(ConfigError, match=f"{wrong}; allowed are row_m"):
            open_receiver(f"simulated:?{wrong}", wait=lambda s: False)


@contextmanager
def receiver(port: int, greeting: bytes, clocks: list[str]) -> Iterator[list[bytes]]:
    """A server that answers each client with the sentences of `clocks` and hangs up after them; what clients said."""
    said: list[bytes] = []
    server = socket.create_server(("127.0.0.1", port))

    def serve() -> None:
        with suppress(OSError):
            while True:
                client, _ = server.accept()
                with client:
                    client.settimeout(5)
                    if greeting:
                        said.append(client.recv(100))
                    client.sendall(rmc("100000.00", "140926"))
                    for clock in clocks:
                        client.sendall(gga(clock))

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield said
    finally:
        server.close()


@pytest.mark.graph
@pytest.mark.parametrize("scheme", ["tcp", "gpsd"])
def test_a_receiver_that_hangs_up_is_asked_again_and_all_is_kept(link: LinkConfig, tmp_path: Path, scheme: str) -> None:
    """A second process of its name was refused only after it had opened the positions of the first."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    config = LineConfig.model_validate(
        {"link": link, "aggregator": {"out": tmp_path}, "gnss": {"source": f"{scheme}://127.0.0.1:{port}"}}
    )
    (tmp_path / "line.toml").write_text(dump_toml(config))
    node = subprocess.Popen(
        [sys.executable, "-m", "tuberline", "gnss", "--config", tmp_path / "line.toml", "--run", "r"]
    )
    try:
        with Observer(link, line=config.name) as observer:

            def counted(name: str) -> int:
                counters = observer.nodes().get("gnss/gnss")
                return 0 if counters is None else counters.count(name)

            wait_until(lambda: counted("receiver_lost") >= 1, what="a receiver that is not there yet")
            clocks = ["100001.00", "100002.00", "100003.00"]
            with receiver(port, b"?WATCH" if scheme == "gpsd" else b"", clocks) as said:
                wait_until(lambda: counted("positions") >= 6, what="positions of two connections")
            if scheme == "gpsd":
                assert said[0].startswith(b'?WATCH={"enable":true,"nmea":true}')
            else:
                other = config.model_copy(update={"aggregator": AggregatorConfig(out=tmp_path / "other")})
                (tmp_path / "other.toml").write_text(dump_toml(other))
                second = [sys.executable, "-m", "tuberline", "gnss", "--config", tmp_path / "other.toml", "--run", "r"]
                assert subprocess.run(second, check=False, capture_output=True, timeout=60).returncode == PERMANENT
                assert not (tmp_path / "other").exists()
        node.send_signal(signal.SIGTERM)
        assert node.wait(30) == 0
    finally:
        node.kill()
    places = read_positions(tmp_path / "positions.csv")
    assert len(places) >= 6
    assert {place.quality for place in places} == {4}
