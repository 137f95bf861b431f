"""Files of all kinds, most of them broken, for every reader of the kit: each is read whole or refused in one line.

``python -m tests.any_file 300`` tries for 300 seconds, and says how many files were read and how many refused; a second
number is the first seed. What fails is kept in the folder ``any_file_failures``.
"""

from __future__ import annotations

import csv
import gzip
import io
import json
import random
import shutil
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from optkit import Instance, scenario, simulate, train
from optkit.basics.errors import OptkitError
from optkit.cli.request_table import read_requests
from optkit.instances.new_york.trips import read_trips
from optkit.instances.storage import load_instances, save_instances
from optkit.learning.trained import Trained
from optkit.models.preferences.offers import Offers

Rows = list[list[str]]

CELLS = [
    *(
        "",
        " ",
        "NA",
        "nan",
        "NaN",
        "null",
        "None",
        "inf",
        "-inf",
        "1e400",
        "-1e308",
        "1e16",
        "1e-400",
        "1e101",
        "9" * 400,
    ),
    *(
        "007",
        "7",
        "7.0",
        "1e3",
        "1000",
        "0x10",
        "1_000",
        "1,000",
        "1.000,5",
        "٣",
        "１",
        "-0",
        "+7",
        "  7",
        "7 ",
        "10001",
        "-1",
    ),
    *("True", "false", "TRUE", "2", "0.5", "1.0", "0", "1", "yes", "20240101.10", "20240101.1"),
    *("2024-01-01", "2018-01-01 11:00:00", "2018-01-01T11:00:00Z", "2018-01-01 11:00:00+05", "01/02/2018 01:00:00 PM"),
    *("1514804400", "9999-12-31 23:59:59", "0001-01-01", "2018-02-30 00:00:00", "2018-01-01 24:00:00", "-05:00"),
    *(
        "'",
        '"',
        '""',
        'a"b',
        "=1+1",
        "\x1b[31m",
        "\u202e",
        "\0",
        "é",
        "中",
        "a\nb",
        "a\rb",
        ";",
        "\t",
        "{}",
        "[1]",
        "265",
        "264",
    ),
]
"""Cells that some program somewhere takes for another."""

NAMES = [
    "",
    " ",
    "value",
    "Value",
    "utility",
    "situation",
    "compensation",
    "chosen",
    "group",
    "pickup",
    "dropoff",
    "reward",
]
NAMES += [
    "request",
    "penalty",
    "expires",
    "x",
    "x",
    "constant",
    "mu",
    "pickup_0",
    "__index_level_0__",
    "Unnamed: 0",
    "\ufeffvalue",
]
NAMES += ["tpep_pickup_datetime", "TPEP_PICKUP_DATETIME", "pulocationid", "a\nb", "\x1b[2J", "007", "compensation "]


# ---- valid tables, as a header and rows of text


def requests(rng: random.Random) -> Rows:
    """Requests of one decision."""
    n = rng.randint(1, 6)
    if rng.random() < 0.5:
        header = ["request", "value", "utility"]
        return [header, *([f"r{i}", f"{rng.uniform(5, 50):.3f}", f"{-rng.uniform(1, 30):.3f}"] for i in range(n))]
    header = ["reward", "penalty", "expires", "utility", "compensation", "request"]
    return [header, *([str(20 + i), "-5", str(i % 2), f"{-rng.uniform(1, 30):.3f}", "10", f"00{i}"] for i in range(n))]


def offers(rng: random.Random) -> Rows:
    """Offers and choices."""
    rows = [["situation", "km", "compensation", "chosen", "group", "pickup"]]
    labels = ["007", "7", "7.0", "7e0", "1e3", "1000", "20240101.10", "20240101.1", "NA", "nan", "mon-1", "-0", "0"]
    for label in rng.sample(labels, rng.randint(1, 5)):
        taken = rng.randint(-1, 1)
        for i in range(rng.randint(1, 3)):
            money = [f"{rng.uniform(1, 8):.2f}", f"{rng.uniform(2, 12):.2f}"]
            rows.append([label, *money, str(int(i == taken)), "0", str(i)])
    return rows


def trips(rng: random.Random) -> Rows:
    """Records of taxi trips."""
    rows = [
        [
            "VendorID",
            "tpep_pickup_datetime",
            "tpep_dropoff_datetime",
            "trip_distance",
            "PULocationID",
            "DOLocationID",
            "x",
        ]
    ]
    for i in range(rng.randint(1, 8)):
        start = f"2018-03-05 11:{rng.randint(0, 29):02d}:{i:02d}"
        rows.append(
            [
                "1",
                start,
                f"2018-03-05 11:{rng.randint(30, 59)}:00",
                "1.5",
                str(rng.choice([12, 43, 230, 263])),
                "236",
                "",
            ]
        )
    return rows


# ---- mutations of tables


def _set(rng: random.Random, rows: Rows) -> None:
    row = rng.choice(rows[1:] or rows)
    if row:
        row[rng.randrange(len(row))] = rng.choice(CELLS)


def _column(rng: random.Random, rows: Rows) -> None:
    at = rng.randrange(max(1, len(rows[0])))
    cell = rng.choice(CELLS)
    for row in rows[1:]:
        if at < len(row):
            row[at] = cell


def _insert(rng: random.Random, rows: Rows) -> None:
    row = rng.choice(rows)
    row.insert(rng.randint(0, len(row)), rng.choice(CELLS))


def _remove(rng: random.Random, rows: Rows) -> None:
    row = rng.choice(rows)
    if row:
        row.pop(rng.randrange(len(row)))


def _rename(rng: random.Random, rows: Rows) -> None:
    if rows[0]:
        rows[0][rng.randrange(len(rows[0]))] = rng.choice([*NAMES, *rows[0]])


def _drop(rng: random.Random, rows: Rows) -> None:
    at = rng.randrange(max(1, len(rows[0])))
    for row in rows:
        del row[at : at + 1]


def _add(rng: random.Random, rows: Rows) -> None:
    at, name = rng.randint(0, len(rows[0])), rng.choice(NAMES)
    for i, row in enumerate(rows):
        row.insert(at, rng.choice(CELLS) if i else name)


def _twice(rng: random.Random, rows: Rows) -> None:
    rows.insert(rng.randint(0, len(rows)), list(rng.choice(rows)))


def _cut(rng: random.Random, rows: Rows) -> None:
    if len(rows) > 1:
        del rows[rng.randint(0, len(rows) - 1)]


def _blank(rng: random.Random, rows: Rows) -> None:
    rows.insert(rng.randint(0, len(rows)), rng.choice([[], [" "], [""] * len(rows[0])]))


def _shuffle(rng: random.Random, rows: Rows) -> None:
    order = rng.sample(range(len(rows[0])), len(rows[0]))
    for i, row in enumerate(rows):
        if len(row) == len(order):
            rows[i] = [row[k] for k in order]


def _case(rng: random.Random, rows: Rows) -> None:
    rows[0] = [rng.choice([str.upper, str.title, str.lower, str])(name) for name in rows[0]]


TABLES = [_set] * 4 + [_column, _insert, _remove, _rename, _drop, _add, _twice, _cut, _blank, _shuffle, _case]


# ---- how tables become bytes


def as_csv(rng: random.Random, rows: Rows) -> bytes:
    """Write CSV as one of many programs does."""
    text = io.StringIO()
    style: dict[str, Any] = {"lineterminator": rng.choice(["\n", "\n", "\r\n", "\r"])}
    if rng.random() < 0.05:
        style["delimiter"] = rng.choice(";\t|")
    if rng.random() < 0.3:
        style["quoting"] = csv.QUOTE_ALL
    csv.writer(text, **style).writerows(rows)
    return _encoded(rng, text.getvalue())


def as_json(rng: random.Random, rows: Rows) -> bytes:
    """Write a list of objects, with numbers as numbers, keys that stand twice and values of all kinds."""

    def value(cell: str) -> str:
        odd = [
            "null",
            "true",
            "[1]",
            '{"a": 1, "a": 2}',
            "NaN",
            "-Infinity",
            "1e999",
            "1" + "0" * 400,
            '"\\ud800"',
            "{}",
        ]
        if rng.random() < 0.01:
            return rng.choice(odd)
        try:
            float(cell)
            return cell if rng.random() < 0.7 else json.dumps(cell)
        except ValueError:
            return json.dumps(cell)

    objects = [
        "{" + ", ".join(f"{json.dumps(k)}: {value(c)}" for k, c in zip(rows[0], row, strict=False)) + "}"
        for row in rows[1:]
    ]
    text = f"[{', '.join(objects)}]"
    wrap = rng.random()
    text = f'{{"requests": {text}}}' if wrap < 0.1 else f'{{"requests": {text}, "mu": 1}}' if wrap < 0.12 else text
    return _encoded(rng, text)


def _encoded(rng: random.Random, text: str) -> bytes:
    code = rng.choice(["utf-8"] * 40 + ["utf-8-sig", "utf-8-sig", "latin-1", "utf-16", "utf-16-le", "utf-32"])
    return text.encode(code, "replace")


def as_parquet(rng: random.Random, rows: Rows) -> bytes:
    """Write parquet with types that somebody chose, empty cells, an index, and columns that stand twice."""
    names, arrays = [], []
    for at, name in enumerate(rows[0]):
        cells: list[Any] = [row[at] if at < len(row) else None for row in rows[1:]]
        cells = [None if cell in ("", None) and rng.random() < 0.5 else cell for cell in cells]
        array = pa.array(cells, pa.string())
        kinds: list[Any] = [
            pa.int64(),
            pa.float64(),
            pa.int8(),
            pa.float32(),
            pa.bool_(),
            pa.timestamp("us"),
            pa.timestamp("ns", "UTC"),
        ]
        kinds += [
            pa.date32(),
            pa.decimal128(20, 3),
            pa.binary(),
            pa.large_string(),
            pa.null(),
            pa.time64("us"),
            pa.duration("s"),
        ]
        for kind in (pa.int64(), pa.float64()) if rng.random() < 0.7 else rng.choices(kinds, k=2):
            try:
                array = (array.cast(pa.int64()) if kind == pa.duration("s") else array).cast(kind)
                break
            except (pa.ArrowException, ValueError):
                continue
        if rng.random() < 0.05:
            array = rng.choice(
                [lambda a: a.dictionary_encode(), lambda a: pa.array([[x] for x in a.to_pylist()]), lambda a: a]
            )(array)
        names.append(name)
        arrays.append(array)
    table = pa.Table.from_arrays(arrays, names=names)
    roll = rng.random()
    if roll < 0.15 and len(set(names)) == len(names) and names:
        frame = table.to_pandas()
        table = pa.Table.from_pandas(frame.set_index(rng.choice(names)) if roll < 0.1 else frame[::-1])
    elif roll < 0.2:
        mark = rng.choice([b"99", b"x", b"-1", b"1", "²".encode()])
        table = table.replace_schema_metadata(
            {b"optkit-offers": mark, b"pandas": rng.choice([b"{", b'{"index_columns": [7, null, {"name": 1}]}', b"[]"])}
        )
    sink = io.BytesIO()
    pq.write_table(table, sink)
    return sink.getvalue()


# ---- mutations of bytes


def spoiled(rng: random.Random, raw: bytes) -> bytes:
    """Flip, insert, delete, repeat and cut bytes."""
    data = bytearray(raw)
    for _ in range(rng.choice([1, 1, 2, 5, 20])):
        at = rng.randrange(len(data) + 1)
        match rng.randrange(6):
            case 0:
                data[at : at + 1] = bytes([rng.randrange(256)])
            case 1:
                data[at:at] = rng.choice(
                    [b"\0", b'"', b",", b"\n", b"\r", b"\xff", b"\xef\xbb\xbf", b"1", b"-", b"{", b"]", b"\x1b[31m"]
                )
            case 2:
                del data[at : at + rng.choice([1, 1, 2, 50])]
            case 3:
                data[at:at] = data[at : at + rng.randint(1, 40)]
            case 4:
                del data[at:]
            case _:
                data[at : at + 4] = rng.randbytes(min(4, len(data) - at)) if at < len(data) else b""
    return bytes(data)


# ---- what must hold of a file that was read


def expect_requests(path: Path) -> None:
    """Every row is there, under its own name, with its own utility."""
    found = read_requests(path)
    n = len(found.names)
    assert n == len(found.value) == len(found.utility) > 0
    assert np.isfinite(found.value).all()
    assert (found.utility < np.inf).all()  # and not NaN
    told = _table(path)
    if told is not None:
        told.columns = [" ".join(str(c).split()).lower() for c in told.columns]
        assert n == len(told)
        if "utility" in told:
            assert found.utility.tolist() == [float(x) for x in told["utility"]]
        if "request" in told:
            assert found.names == list(told["request"])


def expect_offers(path: Path) -> None:
    """Every row is there, and two are one situation only if they are called the same."""
    found = Offers.load(path)
    told = _table(path)
    if told is not None:
        told.columns = [" ".join(str(c).split()) for c in told.columns]
        assert len(found) == len(told)
        if "compensation" in told:
            assert found.compensation.tolist() == [float(x) for x in told["compensation"]]
        if "situation" in told:
            labels = list(told["situation"])
            assert found.n_situations == len(set(labels))
            number = dict(zip(labels, found.situation.tolist(), strict=True))
            assert [number[label] for label in labels] == found.situation.tolist()


def expect_trips(path: Path) -> None:
    """Every row is a trip, or counted under the reason why not."""
    found = read_trips(path)
    assert found.rows == len(found.frame) + sum(found.report.values())
    told = _table(path)
    if told is not None:
        assert found.rows == len(told)


def expect_set(folder: Path) -> None:
    """Every row of the tables is in an instance."""
    found = load_instances(folder)
    for table, rows in (
        ("requests", sum(one.n_requests for one in found)),
        ("workers", sum(one.n_workers for one in found)),
    ):
        assert pq.read_metadata(folder / f"{table}.parquet").num_rows == rows
    assert all(np.isfinite(one.reward).all() and np.isfinite(one.utility).all() for one in found)


def _table(path: Path) -> pd.DataFrame | None:
    """Return the text of a file's cells by other means than the kit's, or None where they may differ in good faith."""
    raw = path.read_bytes()
    if path.suffix == ".gz":
        raw = gzip.decompress(raw)
    if path.suffix == ".parquet":
        file = pq.ParquetFile(io.BytesIO(raw))
        columns: dict[str, Any] = {}
        for field in file.schema_arrow:
            if pa.types.is_integer(field.type) or pa.types.is_string(field.type):
                with suppress(pa.ArrowException, OSError, UnicodeDecodeError):  # a column that nobody asks for
                    columns[field.name] = file.read(columns=[field.name]).column(0).cast(pa.string()).to_pylist()
        return pd.DataFrame(columns, index=range(file.metadata.num_rows), dtype=object)
    if path.suffix == ".json":
        rows = json.loads(raw.decode("utf-8-sig"), parse_int=str, parse_float=str)
        rows = rows["requests"] if isinstance(rows, dict) else rows
        return pd.DataFrame(rows, columns=list(rows[0]) if rows else None, dtype=object)
    text = raw.decode("utf-8-sig")
    if text.replace("\r\n", "\n").count("\r"):
        return None  # pandas ends rows there too, but not within quotation marks
    if any(not line.strip() for line in text.splitlines()) or any(ord(c) < 32 and c not in "\n\r\t" for c in text):
        return None
    rows = [row for row in csv.reader(io.StringIO(text)) if len(row) > 1 or row[0].strip()]
    return pd.DataFrame([row[: len(rows[0])] for row in rows[1:]], columns=rows[0], dtype=object)


READERS: dict[str, tuple[Callable[[random.Random], Rows], Callable[[Path], None]]] = {
    "requests": (requests, expect_requests),
    "offers": (offers, expect_offers),
    "trips": (trips, expect_trips),
}
WRITERS = {"csv": as_csv, "csv.gz": as_csv, "json": as_json, "parquet": as_parquet}
TABLE_KINDS = [f"{what} {kind}" for what in READERS for kind in WRITERS if (what, kind) != ("trips", "json")]
KINDS = [*TABLE_KINDS, "set folder", "policy json"]
"""What is tried: a reader and a format."""


# ---- instance sets


class Valid(NamedTuple):
    """Instance sets and trained policies that are as they should be, to be spoiled in copies."""

    sets: list[Path]
    policies: list[Path]


def valid(place: Path) -> Valid:
    """Write two sets and two policies."""
    one = scenario("II", seed=0, horizon=8).sample(2, seed=1)
    two = scenario("I.1", seed=0, horizon=6).sample(3, seed=1)
    sets = [save_instances(place / "one", one), save_instances(place / "two", [day.with_noise(1) for day in two])]
    days = scenario("I.1", seed=0, horizon=12).sample(12, seed=1)
    policies = [train(days, value, choice="true").save(place / f"{value}.json") for value in ("linear", "kernel")]
    return Valid(sets, policies)


def odd_policy(rng: random.Random, source: Path) -> bytes:
    """Change a policy's file; its own digest is taken out, as whoever edits it may."""
    told = json.loads(source.read_bytes())
    told.pop("sha256", None)
    for _ in range(rng.choice([0, 1, 1, 1, 2])):
        _odd_value(rng, told)
    text = json.dumps(told)
    if rng.random() < 0.05:
        text = text.replace('"version":', '"version": 1, "version":', 1)
    raw = text.encode()
    return spoiled(rng, raw) if rng.random() < 0.1 else raw


def expect_policy(path: Path) -> None:
    """It prices a day, or says why it cannot."""
    policy = Trained.load(path).policy
    assert np.isfinite(simulate(_day(), policy).reward).all()


@cache
def _day() -> Instance:
    return scenario("I.1", seed=0, horizon=12).sample(1, seed=2)[0]


def odd_set(rng: random.Random, source: Path, folder: Path) -> None:
    """Copy a set, change it, and make its checksums right again, mostly."""
    import hashlib

    shutil.copytree(source, folder)
    table = rng.choice(["requests", "workers", "noise"])
    path = folder / f"{table}.parquet"
    told = json.loads((folder / "scenario.json").read_text())
    told.pop("sha256")
    roll = rng.random()
    if roll < 0.1:
        pass
    elif roll < 0.6 and path.exists():
        data = pq.read_table(path)
        for _ in range(rng.choice([1, 1, 2])):
            data = _odd_column(rng, data)
        pq.write_table(data, path)
        told["files"][path.name]["rows"] = data.num_rows if rng.random() < 0.9 else rng.randint(-1, 100)
    elif roll < 0.68 and path.exists():
        path.write_bytes(spoiled(rng, path.read_bytes()))
    elif roll < 0.72:
        path.unlink(missing_ok=True)
    else:
        _odd_value(rng, told)
    if (
        path.exists()
        and isinstance(told.get("files"), dict)
        and isinstance(told["files"].get(path.name), dict)
        and rng.random() < 0.9
    ):
        told["files"][path.name]["sha256"] = hashlib.sha256(path.read_bytes()).hexdigest()
    text = json.dumps(told)
    if rng.random() < 0.05:
        text = text.replace('"horizon":', '"horizon": 3, "horizon":', 1)
    (folder / "scenario.json").write_bytes(text.encode() if rng.random() < 0.93 else spoiled(rng, text.encode()))


def _odd_column(rng: random.Random, data: pa.Table) -> pa.Table:
    at = rng.randrange(data.num_columns)
    field, column = data.schema.field(at), data.column(at)
    values = column.to_pylist()
    match rng.randrange(9):
        case 0:
            return data.append_column(field, column)
        case 1:
            return data.drop_columns([field.name]) if len({f.name for f in data.schema}) == data.num_columns else data
        case 2:
            return data.slice(0, rng.randint(0, data.num_rows))
        case 3:
            return pa.concat_tables([data, data.slice(0, 1)])
        case 4:
            return data.take(pa.array(rng.sample(range(data.num_rows), data.num_rows), pa.int64()))
        case 5:
            kind = rng.choice(
                [pa.string(), pa.int32(), pa.float32(), pa.bool_(), pa.decimal128(38, 6), pa.list_(pa.int64())]
            )
            try:
                return data.set_column(at, pa.field(field.name, kind), column.cast(kind))
            except (pa.ArrowException, ValueError):
                return data
        case 6:
            return data.set_column(at, pa.field(field.name, field.type), pa.nulls(data.num_rows, field.type))
        case _:
            if values:
                odd = (
                    [-1, 0, 0, 1, 1, 2, 2**62, 10**6, 1_700_000_000]
                    if pa.types.is_integer(field.type)
                    else [-1.0, 0.0, -2.5, float("nan"), float("inf"), -1e308, 1e308, None, 5e-324]
                )
                values[rng.randrange(len(values))] = rng.choice(odd)
            try:
                return data.set_column(at, pa.field(field.name, field.type), pa.array(values, field.type))
            except (pa.ArrowException, ValueError):  # a column of decimals, for example, takes no such number
                return data


def _odd_value(rng: random.Random, told: dict[str, Any]) -> None:
    where: Any = told
    key: Any = rng.choice(list(told))
    while isinstance(where[key], dict | list) and where[key] and rng.random() < 0.8:
        where = where[key]
        key = rng.choice(list(where) if isinstance(where, dict) else list(range(len(where))))
    odd = [
        None,
        True,
        -1,
        0,
        1,
        7,
        2**62,
        2**70,
        10**30,
        1.5,
        float("nan"),
        "x",
        "",
        [],
        {},
        [1],
        {"a": [1]},
        1_700_000_000,
        99_999,
    ]
    if rng.random() < 0.15 and isinstance(where, dict):
        del where[key]
    else:
        where[key] = rng.choice(odd)


# ---- tries


def attempt(seed: int, place: Path, whole: Valid) -> tuple[str, str]:
    """Make the file of a seed and read it; return of which kind it is and what became of it.

    Raises
    ------
    Exception
        Whatever a reader lets through that is no OptkitError, or an AssertionError if it loses or changes rows.
    """
    rng = random.Random(seed)
    what, kind = rng.choice(KINDS).split(" ")
    if what == "set":
        path, check = place / f"{seed}", expect_set
        odd_set(rng, rng.choice(whole.sets), path)
    elif what == "policy":
        path, check = place / f"{seed}.json", expect_policy
        path.write_bytes(odd_policy(rng, rng.choice(whole.policies)))
    else:
        make, check = READERS[what]
        rows = make(rng)
        for _ in range(rng.choice([0, 1, 1, 1, 2])):
            rng.choice(TABLES)(rng, rows)
            rows = rows if rows and rows[0] else [[""]]
        try:
            raw = WRITERS[kind](rng, rows)
        except (pa.ArrowException, ValueError, TypeError, KeyError):
            raw = as_csv(rng, rows)
        zipped = rng.random() < 0.5
        if kind == "csv.gz" and zipped:
            raw = gzip.compress(raw)
        if rng.random() < 0.15:
            raw = spoiled(rng, raw)
        if kind == "csv.gz" and not zipped:
            raw = gzip.compress(raw)
        path = place / f"{seed}.{kind}"
        path.write_bytes(raw)
    try:
        with warnings.catch_warnings(action="ignore"):
            check(path)
    except OptkitError as error:
        message = str(error)
        assert message
        assert message.isprintable(), message
        return f"{what} {kind}", "refused"
    return f"{what} {kind}", "read"


def main(seconds: float, first: int = 0) -> int:
    """Try for some time; print the counts, keep what fails, and return how many fail."""
    counts: Counter[tuple[str, str]] = Counter()
    end, seed, failed = time.monotonic() + seconds, first, 0
    kept = Path("any_file_failures")
    with tempfile.TemporaryDirectory() as place:
        whole = valid(Path(place) / "whole")
        while time.monotonic() < end:
            with tempfile.TemporaryDirectory(dir=place) as own:
                try:
                    counts[attempt(seed, Path(own), whole)] += 1
                except Exception:
                    failed += 1
                    kept.mkdir(exist_ok=True)
                    (kept / f"{seed}.txt").write_text(traceback.format_exc(), errors="backslashreplace")
                    for one in Path(own).iterdir():
                        (shutil.copytree if one.is_dir() else shutil.copy)(one, kept / one.name)
                    print(f"seed {seed}: {traceback.format_exc(limit=-1).splitlines()[-1][:300]}", flush=True)
            seed += 1
    for kind in sorted({kind for kind, _ in counts}):
        print(f"{kind:20s} read {counts[kind, 'read']:8,}  refused {counts[kind, 'refused']:8,}")
    print(f"{seed - first:,} files from seed {first}: {failed} failures")
    return failed


if __name__ == "__main__":
    sys.exit(bool(main(float(sys.argv[1]), int(sys.argv[2]) if len(sys.argv) > 2 else 0)))
