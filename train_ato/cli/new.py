"""``train-ato new KIND NAME``: write a commented file of one's own that runs as it is.

Options::

    kind KIND       %(choices)s
    name NAME       name of the new thing; the file is NAME.yaml or NAME.py
    --like SHIPPED  begin with this shipped one (train-ato list) in place of the template
"""

import argparse
import re
from contextlib import ExitStack
from importlib.util import find_spec
from keyword import iskeyword
from pathlib import Path

from train_ato.program.arguments import Options

YAML_KINDS = ("train", "line", "journey", "scenario")
CODE_KINDS = {"law": "MyLaw", "observer": "MyObserver", "compensation": "MyCompensation"}
"""Kinds in Python, with the class of their template."""
MISSING = {
    "examples": "the templates are missing in this installation; install train_ato again",
    "site": "the site is not built; in the source folder run pip install -e '.[docs]' and "
    "python -m msgs_docs.generate --site",
}
"""Message for each folder that an installation may lack."""

OPTIONS: Options = {"kind": {"choices": (*YAML_KINDS, *CODE_KINDS)}}


def execute(options: argparse.Namespace) -> None:
    """Write the files, then print their names and the next command."""
    from train_ato.cli.screen import print_result
    from train_ato.log.whole_file import write_whole
    from train_ato.program.arguments import check_new_file
    from train_ato.program.errors import refused_unwritten

    if not re.fullmatch(r"[a-z][a-z0-9_]*", options.name):
        form = "begin with a lower-case letter, then letters, digits and _"
        raise ValueError(f"NAME {options.name}: {form}, for example my_{options.kind}")
    texts, following = (_code if options.kind in CODE_KINDS else _data)(options.kind, options.name, options.like)
    for path in texts:
        check_new_file(path, (path.suffix,), "NAME")
    # A folder without ``__init__.py`` has no origin, and a file precedes it.
    module = find_spec(options.name) if options.kind in CODE_KINDS else None
    if options.kind in CODE_KINDS and (iskeyword(options.name) or (module is not None and module.origin is not None)):
        raise ValueError(f"NAME {options.name}: Python has this word or module already; choose another name")
    with ExitStack() as made:
        for path, text in texts.items():
            with refused_unwritten(path, "choose another folder"):
                write_whole(path, text)
            made.callback(path.unlink)
        made.pop_all()  # the files stay only together: the command could not be repeated beside some of them
    text = "".join(f"{path}\n" for path in texts) + f"next: {following}\n"
    print_result({"files": [str(path) for path in texts], "next": following}, text, as_json=options.json)


def _data(kind: str, name: str, like: str | None) -> tuple[dict[Path, str], str]:
    """Return the texts by file and the next command of a train, line, journey or scenario."""
    source = _shipped(kind, like) if like else _examples() / "metro" / f"{kind}.yaml"
    target = Path(f"{name}.yaml")
    text = re.sub(r"(?m)^# yaml-language-server:.*\n", "", source.read_text(encoding="utf-8"))
    text = re.sub(r"(?m)^name: .*$", f"name: {name}", text, count=1)
    texts = {target: text}
    if kind == "scenario":
        for other in re.findall(r"(?m)^ +(?:consist|line|file): ([\w.-]+\.(?:yaml|csv))\b", text):
            if not Path(other).exists():
                texts[Path(other)] = (source.parent / other).read_text(encoding="utf-8")
    following = {
        "train": f"train-ato plan level {target} --to-km 3",
        "line": f"train-ato plan {target} xuzhou_metro_3",
        "journey": f"train-ato plan LINE TRAIN --journey {target}",
        "scenario": f"train-ato run {target} --engine",
    }
    return texts, following[kind]


def _shipped(kind: str, name: str) -> Path:
    """Return the file of a shipped train, line or scenario."""
    from plant_sim.input_error import close_match
    from plant_sim.library import consist_names, consist_path, line_names, line_path
    from train_ato.scenario.scenario_files import shipped_scenarios

    if kind == "journey":
        raise ValueError(f"--like {name}: no journey is shipped; leave the option out")
    found = {
        "train": {key: consist_path(key) for key in consist_names()},
        "line": {key: line_path(key) for key in line_names()},
        "scenario": shipped_scenarios(),
    }[kind]
    if name not in found:
        raise ValueError(f"--like {name}: no shipped {kind}{close_match(name, found)}; give one of {', '.join(found)}")
    return found[name]


def _code(kind: str, name: str, like: str | None) -> tuple[dict[Path, str], str]:
    """Return the text by file and the next command of a law, observer or compensation."""
    import inspect

    from train_ato.control.registry import REGISTRIES

    module, target = CODE_KINDS[kind], Path(f"{name}.py")
    if like is None:
        template = re.sub("(?<!^)(?=[A-Z])", "_", module).lower()
        block = "".join(part.capitalize() for part in name.split("_"))
        text = (_examples() / f"{template}.py").read_text(encoding="utf-8")
        text = re.sub(rf"\b{template}\b", name, text).replace(module, block)
    else:
        try:
            found = REGISTRIES[kind].get(like)
        except ValueError as error:
            raise ValueError(f"--like {error}") from None
        block = found.__name__
        text = Path(inspect.getfile(found)).read_text(encoding="utf-8")
    return {target: text}, f"train-ato check-{kind} {name}:{block}"


def _examples() -> Path:
    """Return the folder of the templates."""
    return data_folder("examples", "my_law.py")


def data_folder(name: str, file: str) -> Path:
    """Return a folder of files beside the code: of the source tree, or of the installed package."""
    source = Path(__file__).resolve().parents[2] / name
    if (source / file).is_file():
        return source
    from importlib.metadata import files

    for path in files("train_ato") or ():
        if path.name == file and path.parent.name == name and Path(str(path.locate())).is_file():
            return Path(str(path.locate())).resolve().parent
    raise ValueError(MISSING[name])
