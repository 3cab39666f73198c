"""A line or a train written in another format."""

from pathlib import Path
from typing import Any

from plant_sim.formats.line_table import line_csv
from plant_sim.formats.osrd_stock import KEPT, osrd_stock_json
from plant_sim.formats.railml import ENDINGS as RAILML
from plant_sim.formats.railml_writer import line_railml, train_railml
from plant_sim.formats.reading import holds_train
from plant_sim.formats.survey import line_geojson, line_gpx
from plant_sim.formats.writing import own_yaml, ttobench_json
from plant_sim.library import consist_names, line_names, named_line, named_train, split_name
from train_ato.log.whole_file import write_whole
from train_ato.program.arguments import check_new_file
from train_ato.program.errors import refused_unwritten

OWN, JSON = (".yaml", ".yml"), ".json"
LINES = {
    JSON: ttobench_json, ".csv": line_csv, ".gpx": line_gpx, ".geojson": line_geojson,
    **dict.fromkeys(RAILML, line_railml),
}  # fmt: skip
"""Writer of a line by the ending of its file."""
TRAINS = {JSON: osrd_stock_json, **dict.fromkeys(RAILML, train_railml)}


def convert(source: str | Path, out: str | Path) -> dict[str, Any]:
    """Write a line or a train in another format, as ``train-ato convert`` does.

    Parameters
    ----------
    source
        Shipped name or file.
    out
        New file: .yaml in the own format, .railml or .xml of railML 3, a line as TTOBench .json, table .csv, .gpx or
        .geojson, a train as rolling stock of OSRD .json.

    Returns
    -------
    dict
        ``kind``, ``name``, ``format``, ``file``, and in ``left_out`` the keys that the new file does not carry.

    Raises
    ------
    ValueError
        One line: file, key, value, problem; remedy.
    """
    source, target = str(source), Path(out)
    check_new_file(target, (*OWN, *LINES), "OUT")
    stem = split_name(source)[0]
    shipped = (*consist_names(), *line_names())
    if stem not in shipped and not Path(stem).is_file():
        raise ValueError(f"IN {source}: neither a file nor a shipped name; give a line or train file")
    if stem in consist_names() or (stem not in shipped and holds_train(Path(stem))):
        if target.suffix.lower() not in (*OWN, *TRAINS):
            raise ValueError(f"OUT {target}: {target.suffix} has a line; write a train as .yaml, .json or .railml")
        found = named_train(source)
        write_train = TRAINS.get(target.suffix.lower())
        text, lost = (own_yaml(found.consist), ()) if write_train is None else write_train(found.consist)
        kept = {} if write_train is train_railml else found.consist.kept.get(KEPT, {})
        left = [key for key in found.left_out if key.partition(".")[0].removesuffix("[]") not in kept]
        name, left_out = found.consist.name, (*left, *lost)
        kind, form = "train", found.format
    else:
        read = named_line(source)
        kind, form, name = "line", read.format, read.line.name
        write = LINES.get(target.suffix.lower())
        text, lost = (own_yaml(read.line), ()) if write is None else write(read.line)
        left_out = (*read.left_out, *lost)
    with refused_unwritten(f"OUT {target}"):
        write_whole(target, text)
    return {"kind": kind, "name": name, "format": form, "file": str(out), "left_out": list(left_out)}
