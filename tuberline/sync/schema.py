"""The tables that lines are synced into, in a schema of their own, and the views to read them by."""

from __future__ import annotations

SCHEMA = "tuberline"
VERSION = 1
NEWEST = "is_load"
"""The column of `load` that came last: false of what passed without one. A database that lacks it is brought up to
date."""
LOCK = 0x54554252
"""'TUBR': two machines that sync for the first time at once make the tables one after the other."""


def _as_typed(column: str) -> tuple[str, str]:
    """(a name as it was first given, what names have in common that are one: 'Agria', 'agria' and ' AGRIA' are), as in
    `conveyor.typed_names`.
    """
    first = f"(array_agg({column} ORDER BY day, ledger, place))[1]"
    return first, rf"lower(regexp_replace(btrim({column}), '\s+', ' ', 'g'))"


STATEMENTS: tuple[str, ...] = (
    f"CREATE SCHEMA IF NOT EXISTS {SCHEMA}",
    f"CREATE TABLE IF NOT EXISTS {SCHEMA}.version (one boolean PRIMARY KEY DEFAULT true CHECK (one), version integer)",
    f"INSERT INTO {SCHEMA}.version (version) VALUES ({VERSION}) ON CONFLICT DO NOTHING",
    f"""CREATE TABLE IF NOT EXISTS {SCHEMA}.run (
        id bigint GENERATED ALWAYS AS IDENTITY PRIMARY KEY,
        line text NOT NULL,
        run text NOT NULL,
        started_ns bigint NOT NULL,
        started_at timestamptz NOT NULL,
        cameras text[] NOT NULL,
        version text NOT NULL,
        summary jsonb,
        UNIQUE (line, run, started_ns))""",
    f"""CREATE TABLE IF NOT EXISTS {SCHEMA}.tuber (
        run_id bigint NOT NULL REFERENCES {SCHEMA}.run (id) ON DELETE CASCADE,
        tuber integer NOT NULL,
        crossed_at timestamptz NOT NULL,
        weight_g double precision NOT NULL,
        low_g double precision NOT NULL,
        high_g double precision NOT NULL,
        length_mm real NOT NULL,
        width_mm real NOT NULL,
        height_mm real NOT NULL,
        place_x_m double precision NOT NULL,
        place_y_m real NOT NULL,
        views smallint NOT NULL,
        method text NOT NULL,
        model text NOT NULL,
        flags text[] NOT NULL,
        crc bigint NOT NULL,
        PRIMARY KEY (run_id, tuber))""",
    f"CREATE INDEX IF NOT EXISTS tuber_crossed_at ON {SCHEMA}.tuber (crossed_at)",
    f"""CREATE TABLE IF NOT EXISTS {SCHEMA}.load (
        line text NOT NULL,
        ledger bigint NOT NULL REFERENCES {SCHEMA}.run (id) ON DELETE CASCADE,
        place integer NOT NULL,
        load text NOT NULL,
        field text NOT NULL,
        variety text NOT NULL,
        day date NOT NULL,
        tubers integer NOT NULL,
        raw_kg double precision,
        weight_kg double precision,
        low_kg double precision,
        high_kg double precision,
        coverage double precision,
        ticket_kg double precision,
        PRIMARY KEY (ledger, place))""",
    f"ALTER TABLE {SCHEMA}.load ADD COLUMN IF NOT EXISTS {NEWEST} boolean NOT NULL DEFAULT true",
    *(
        f"ALTER TABLE {SCHEMA}.load ALTER COLUMN {kg} DROP NOT NULL"
        for kg in ("raw_kg", "weight_kg", "low_kg", "high_kg")
    ),
    f"""CREATE TABLE IF NOT EXISTS {SCHEMA}.told (
        ledger bigint PRIMARY KEY REFERENCES {SCHEMA}.run (id) ON DELETE CASCADE,
        event integer NOT NULL,
        crc bigint NOT NULL)""",
    *(
        f"""CREATE OR REPLACE VIEW {SCHEMA}.totals_by_{by} AS
        SELECT {told} AS {by}, count(*) FILTER (WHERE is_load) AS loads, sum(tubers) AS tubers,
            sum(raw_kg) AS raw_kg, sum(weight_kg) AS weight_kg, sum(low_kg) AS low_kg,
            sum(high_kg) AS high_kg, sum(ticket_kg) AS ticket_kg
        FROM {SCHEMA}.load GROUP BY {alike}"""
        for by, told, alike in (
            ("field", *_as_typed("field")),
            ("variety", *_as_typed("variety")),
            ("day", "day", "day"),
            ("line", "line", "line"),
        )
    ),
)
"""What makes the tables and views; each may be run again, and all are where `NEWEST` or a table lacks. `told` has the
newest event of loads (start, note, ticket) that a ledger held when it was synced. The bounds of a sum are
the sums of the bounds, as if all loads were off together: what they share does, so the interval is too wide rather than
too narrow."""
