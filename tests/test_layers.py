"""The house rule of the package: imports only go up the list of stages, each heavy library has one importer.

No module imports itself by way of others. The rules are read from the syntax tree, so nothing is imported, and the
checker itself is held to synthetic violations.
"""

from __future__ import annotations

import ast
from collections.abc import Iterable, Iterator
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parent.parent
STAGES = [
    "io", "scene", "sonar", "render", "sensor", "data", "segment", "match", "refine", "calibrate", "shape",
    "recognition", "recognize", "track", "results", "plot", "cli",
]  # fmt: skip
SPEED = {"cluster", "cpu"}  # nothing but speed: optional
# Below everything: any file may import them, and they import no stage but io.
BASE = {"crops", "records", "engine", "exact"}
OUTSIDE = {"cluster", "cpu", "__init__", "__main__"}  # beside the order
ONLY_IMPORTER = {"trimesh": "scene", "jaxopt": "refine"}
FORBIDDEN = {"pickle", "cPickle", "dill", "cloudpickle", "joblib", "shelve", "marshal"}
MAX_LINES = 450


def imported_modules(source: str, package: list[str]) -> Iterator[tuple[int, str]]:
    """(line, dotted name) of everything that a file of `package` imports, anywhere in it."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else []
            module = ".".join([*base, *([node.module] if node.module else [])])
            yield from ((node.lineno, f"{module}.{alias.name}") for alias in node.names)
        elif isinstance(node, ast.Call) and _called(node.func) in {"import_module", "__import__"}:
            name = node.args[0] if node.args else None
            yield node.lineno, name.value if isinstance(name, ast.Constant) else "a name computed at run time"


def _called(function: ast.expr) -> str:
    return function.attr if isinstance(function, ast.Attribute) else getattr(function, "id", "")


def violations(path: str, source: str) -> list[str]:
    """What is wrong with the file at `path` (from the project's root, with slashes): one sentence each."""
    found = []
    lines = source.count("\n")
    if lines > MAX_LINES:
        found.append(f"{path} has {lines} lines, more than {MAX_LINES}")
    parts = path.removesuffix(".py").split("/")
    for line, name in imported_modules(source, parts[:-1]):
        complaint = _complaint(parts, name.split("."))
        if complaint:
            found.append(f"{path}:{line}: {complaint}")
    return found


def _complaint(parts: list[str], imported: list[str]) -> str | None:
    top = imported[0]
    if top in FORBIDDEN:
        return f"imports {top}, which runs code from files"
    if top == "paper_figs" and parts[0] in {"sonarjax", "experiments"}:
        return "imports a figure script"
    if parts[0] != "sonarjax":
        return None
    if top in {"experiments", "tests", "notebooks"} or "computed" in top:
        return f"imports {top}"
    stage = parts[1]  # a folder of the package, or a file of its top
    if top in ONLY_IMPORTER and stage != ONLY_IMPORTER[top]:
        return f"imports {top}: only {ONLY_IMPORTER[top]}/ may"
    if imported[:2] == ["sonarjax", "data"] and stage == "segment" and "training" not in parts:
        return "inference imports the data that networks are trained with"
    if top == "sonarjax":
        return _wrong_direction(stage, imported[1:], is_folder=len(parts) > 2)
    return None


def _wrong_direction(stage: str, imported: list[str], is_folder: bool) -> str | None:
    target = imported[0] if imported else "__init__"
    if stage == "__init__" and imported == ["cpu"]:
        return None  # `sonarjax.cpu` as an attribute; tests/test_api.py holds that it is imported on first use only
    if target in SPEED and stage not in {"cli", "cluster"}:
        return f"imports {target}: only the command line may, beside experiments, notebooks and tests"
    if stage in OUTSIDE:
        return None
    if stage in BASE:
        return None if target in {"io"} | BASE else f"{stage} stands below {target}"
    if stage not in STAGES:
        return f"{stage} is not in the list of stages: {', '.join(STAGES)}"
    if target in BASE or (target == stage and is_folder) or (target in SPEED and stage == "cli"):
        return None
    if target not in STAGES:
        return f"imports {target} from the package's top: import it from its own folder"
    if STAGES.index(target) >= STAGES.index(stage):
        return f"{stage} imports {target}, which comes after it"
    return None


def project_files() -> list[Path]:
    return sorted(p for folder in ("sonarjax", "experiments", "paper_figs") for p in (PROJECT / folder).rglob("*.py"))


@pytest.mark.parametrize("file", project_files(), ids=lambda p: p.relative_to(PROJECT).as_posix())
def test_file_keeps_the_rule(file: Path) -> None:
    assert violations(file.relative_to(PROJECT).as_posix(), file.read_text(encoding="utf-8")) == []


def circles(sources: dict[str, str]) -> list[str]:
    """Modules that import themselves by way of others, from the source of each module by its dotted name.

    Imports inside functions count: they would only hide a circle. A package is its `__init__`.
    """
    reached = {name: _modules_of(name, source, sources) for name, source in sources.items()}
    while True:
        wider = {name: there.union(*(reached[one] for one in there)) for name, there in reached.items()}
        if wider == reached:
            return sorted(name for name, there in reached.items() if name in there)
        reached = wider


def _modules_of(name: str, source: str, known: Iterable[str]) -> set[str]:
    found = set()
    for _, imported in imported_modules(source, name.split(".")[:-1]):
        parts = imported.split(".")
        candidates = (".".join(parts[:k]) for k in range(len(parts), 0, -1))
        found |= {one for one in [next((c for c in candidates if c in known), None)] if one and one != name}
    return found


def package_sources() -> dict[str, str]:
    files = sorted((PROJECT / "sonarjax").rglob("*.py"))
    names = [p.relative_to(PROJECT).with_suffix("").as_posix().replace("/", ".") for p in files]
    return {n.removesuffix(".__init__"): p.read_text(encoding="utf-8") for n, p in zip(names, files, strict=True)}


def test_no_module_imports_itself_by_way_of_others() -> None:
    assert circles(package_sources()) == []


def test_circle_is_seen() -> None:
    sources = {
        "sonarjax.a.x": "def f():\n    from sonarjax.a.y import g",
        "sonarjax.a.y": "from sonarjax.a import z",
        "sonarjax.a.z": "import sonarjax.a.x",
        "sonarjax.a.w": "from sonarjax.a.x import f",
    }
    assert circles(sources) == ["sonarjax.a.x", "sonarjax.a.y", "sonarjax.a.z"]
    assert circles(sources | {"sonarjax.a.z": ""}) == []


def test_package_has_no_other_folder() -> None:
    folders = {p.parent.relative_to(PROJECT / "sonarjax").parts for p in (PROJECT / "sonarjax").rglob("*.py")}
    assert {parts[0] for parts in folders if parts} <= set(STAGES)
    files = {p.stem for p in (PROJECT / "sonarjax").glob("*.py")}
    assert files <= OUTSIDE | BASE | {"recognition", "recognize", "results", "plot"}


BAD = {
    "upwards": ("sonarjax/scene/a.py", "from sonarjax.render import render"),
    "upwards in a function": ("sonarjax/scene/a.py", "def f():\n    from sonarjax.sonar.model import Sonar"),
    "upwards, plain import": ("sonarjax/match/a.py", "import sonarjax.refine.solve"),
    "upwards, relative": ("sonarjax/sonar/a.py", "from ..render import render"),
    "upwards, relative package": ("sonarjax/sonar/a.py", "from .. import render"),
    "upwards, from the package": ("sonarjax/match/a.py", "from sonarjax import recognize"),
    "upwards, by name": ("sonarjax/match/a.py", "import importlib\nimportlib.import_module('sonarjax.cli')"),
    "computed name": ("sonarjax/match/a.py", "import importlib\nimportlib.import_module(name)"),
    "io knows no other": ("sonarjax/io/a.py", "from sonarjax.scene import Pose"),
    "the top namespace": ("sonarjax/render/a.py", "import sonarjax as sj"),
    "a name of the top": ("sonarjax/render/a.py", "from sonarjax import Pose"),
    "itself at the top": ("sonarjax/plot.py", "import sonarjax.plot"),
    "plot imports cli": ("sonarjax/plot.py", "from sonarjax.cli import main"),
    "unknown folder": ("sonarjax/utils/a.py", "from sonarjax.io import Frame"),
    "trimesh elsewhere": ("sonarjax/render/a.py", "import trimesh.ray"),
    "trimesh at the top": ("sonarjax/cli/a.py", "from trimesh import Trimesh"),
    "jaxopt elsewhere": ("sonarjax/match/a.py", "from jaxopt import LBFGSB"),
    "pickle": ("sonarjax/io/a.py", "import pickle"),
    "pickle in an experiment": ("experiments/a.py", "from pickle import loads"),
    "experiment draws": ("experiments/a.py", "from paper_figs import fig7"),
    "package runs an experiment": ("sonarjax/cli/a.py", "import experiments.bench_all"),
    "a stage tunes the process": ("sonarjax/render/a.py", "from sonarjax.cpu import tune"),
    "a stage asks for workers": ("sonarjax/data/a.py", "from sonarjax.cluster import connect"),
    "a stage asks for threads": ("sonarjax/recognize.py", "from sonarjax import cpu"),
    "importing tunes the process": ("sonarjax/__init__.py", "from sonarjax.cpu import tune"),
    "inference knows training data": ("sonarjax/segment/a.py", "from sonarjax.data import Pairs"),
    "records know a stage": ("sonarjax/records.py", "from sonarjax.scene import Pose"),
    "too long": ("sonarjax/io/a.py", "x = 1\n" * (MAX_LINES + 1)),
}

GOOD = {
    "own folder": ("sonarjax/match/a.py", "from sonarjax.match.b import c\nfrom .b import c\nfrom . import b"),
    "earlier stages": (
        "sonarjax/refine/a.py",
        "import jaxopt\nfrom sonarjax.match import x\nfrom sonarjax.io import y",
    ),
    "a mesh": ("sonarjax/scene/a.py", "import trimesh"),
    "top files": (
        "sonarjax/cli/a.py",
        "from sonarjax import plot, recognize\nfrom sonarjax.recognize import recognize",
    ),
    "a command, the processor": (
        "sonarjax/cli/a.py",
        "from sonarjax import cpu\nfrom sonarjax.cpu import CpuEngine",
    ),
    "the package's face": ("sonarjax/__init__.py", "from sonarjax.engine import x\nfrom sonarjax.cli import main"),
    "an attribute of the face": ("sonarjax/__init__.py", "def f():\n    import_module('sonarjax.cpu')"),
    "what is below all": (
        "sonarjax/io/a.py",
        "from sonarjax.records import record\nimport sonarjax.engine",
    ),
    "the processor knows results": ("sonarjax/cpu.py", "from sonarjax.refine.yaw import YawEstimate"),
    "a command, a cluster": ("sonarjax/cli/a.py", "from sonarjax.cluster import connect"),
    "a cluster of processors": ("sonarjax/cluster.py", "from sonarjax.cpu import CpuEngine"),
    "an experiment tunes": ("experiments/a.py", "from sonarjax.cpu import tune"),
    "a figure script": ("paper_figs/fig7.py", "from sonarjax.plot import polar\nfrom paper_figs import style"),
    "long enough": ("sonarjax/io/a.py", "x = 1\n" * MAX_LINES),
}


@pytest.mark.parametrize("case", BAD)
def test_checker_sees(case: str) -> None:
    assert len(violations(*BAD[case])) == 1


@pytest.mark.parametrize("case", GOOD)
def test_checker_allows(case: str) -> None:
    assert violations(*GOOD[case]) == []
