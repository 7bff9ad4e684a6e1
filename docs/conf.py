"""The documentation site: `make docs`. Sources are read where they stand in the repository, so their links work there.

Pages of docs/ appear in the order in which docs/README.md names them, and any others after these. Notebooks are shown
as they are stored, without output. With SONARJAX_NOTEBOOKS naming a folder of executed copies, as
`python -m notebooks.run` leaves them (`make docs-all`), those are shown.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import os
import pkgutil
import re
import sys
from itertools import pairwise
from pathlib import Path
from types import ModuleType
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

import sonarjax  # noqa: E402

project, author, release = "sonarjax", "The sonarjax authors", sonarjax.__version__
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
napoleon_numpy_docstring = False
napoleon_use_rtype = False
root_doc = "docs/README"
include_patterns = [
    "README.md", "CHANGELOG.md", "CONTRIBUTING.md", "docs/*.md", "docs/api/*", "notebooks/*", "experiments/README.md",
    "paper_figs/README.md",
]  # fmt: skip
exclude_patterns = ["notebooks/*.py", "notebooks/__pycache__"]
nb_execution_mode = "off"
myst_heading_anchors = 3
myst_enable_extensions = ["dollarmath", "deflist"]
myst_links_external_new_tab = False

html_theme = "furo"
html_title = f"sonarjax {release}"
templates_path = ["_templates"]
html_additional_pages = {"index": "to_front.html"}
html_copy_source = False

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_default_options = {"members": True, "show-inheritance": False}
default_role = "literal"
API = ROOT / "docs" / "api"


def setup(app: Any) -> None:
    """Connect what is done to sources on the way."""
    write_api_pages()
    app.connect("source-read", on_source)
    app.connect("autodoc-process-docstring", on_docstring)


def on_source(app: Any, docname: str, source: list[str]) -> None:
    """Give the front page its tables of contents, and a notebook its outputs where there are executed copies."""
    executed = os.environ.get("SONARJAX_NOTEBOOKS")
    if docname == root_doc:
        tables = (f"```{{toctree}}\n:hidden:\n:caption: {title}\n\n{body}\n```\n" for title, body in contents())
        source[0] += "\n" + "\n".join(tables)
    elif docname.startswith("notebooks/") and executed and (ROOT / executed / f"{docname[10:]}.ipynb").exists():
        source[0] = (ROOT / executed / f"{docname[10:]}.ipynb").read_text(encoding="utf-8")


def contents() -> list[tuple[str, str]]:
    """Captions of the front page's tables of contents, and the documents of each."""
    found = sorted(path.stem for path in (ROOT / "docs").glob("*.md") if path.stem != "README")
    named = re.findall(r"\]\((\w+)\.md\)", (ROOT / "docs" / "README.md").read_text(encoding="utf-8"))
    pages = [name for name in dict.fromkeys(named) if name in found]
    pages += [name for name in found if name not in pages]
    notebooks = sorted(path.stem for path in (ROOT / "notebooks").glob("*.ipynb"))
    return [
        ("Guide", "\n".join(f"/docs/{name}" for name in pages)),
        ("Tutorials", "\n".join(f"/notebooks/{name}" for name in ["README", *notebooks])),
        ("Python", "\n".join(f"/docs/api/{name}" for name in api_modules())),
        ("Project", "/README\n/experiments/README\n/paper_figs/README\n/CONTRIBUTING\n/CHANGELOG"),
    ]


def api_modules() -> list[str]:
    """The package and those of its folders that have public names of their own."""
    folders = [f"sonarjax.{m.name}" for m in pkgutil.iter_modules(sonarjax.__path__) if m.ispkg and m.name != "cli"]
    return ["sonarjax", *folders, "sonarjax.segment.training", "sonarjax.cpu", "sonarjax.plot"]


def write_api_pages() -> None:
    """One page for each module: its docstring, and the public names that no page before it has."""
    API.mkdir(exist_ok=True)
    seen: set[int] = set()
    for name in api_modules():
        module = importlib.import_module(name)
        public = getattr(module, "__all__", None) or [n for n, v in vars(module).items() if _own(n, v, name)]
        things = {n: getattr(module, n) for n in public}
        new = {n: v for n, v in things.items() if id(v) not in seen or not _is_described_once(v)}
        seen |= {id(v) for v in things.values()}
        # A folder may bear the name of its function (`sonarjax.render`): the index has the function.
        lines = [name, "=" * len(name), "", f".. automodule:: {name}", "   :no-members:", "   :no-index:", ""]
        if len(new) < len(things):
            others = ", ".join(f"``{n}``" for n in things if n not in new)
            lines += [f"Also here, described above in the list: {others}.", ""]
        for n, thing in new.items():
            lines += _entry(name, n, thing)
        text = "\n".join(lines)
        path = API / f"{name}.rst"
        if not path.exists() or path.read_text(encoding="utf-8") != text:  # else Sphinx would read it again each time
            path.write_text(text, encoding="utf-8")


def _is_described_once(thing: Any) -> bool:
    """False for numbers and texts, equal ones of which may be one object under two names."""
    return callable(thing) or isinstance(thing, ModuleType)


def _own(name: str, value: Any, module: str) -> bool:
    return not name.startswith("_") and callable(value) and getattr(value, "__module__", None) == module


def _entry(module: str, name: str, thing: Any) -> list[str]:
    """The lines that describe one public name."""
    if isinstance(thing, ModuleType):
        return [f".. automodule:: {thing.__name__}", "   :members:", ""]
    if isinstance(thing, type):
        kind = "autoexception" if issubclass(thing, BaseException) else "autoclass"
        return [f".. {kind}:: {module}.{name}", ""]
    if callable(thing):
        return [f".. autofunction:: {module}.{name}", ""]
    # A constant's docstring stands under it where it is assigned, which Sphinx cannot know of an imported one.
    text = ["", *(f"   {line}" for line in plain_markup(_docstring_of(module, name)).split("\n")), ""]
    shown = repr(thing) if isinstance(thing, str | int | float | tuple) and len(repr(thing)) < 200 else ""
    value = [f"   :value: {shown}"] if shown else []
    return [f".. py:data:: {module}.{name}", *value, *text]


def _docstring_of(module: str, name: str) -> str:
    for other in sorted(m for m in sys.modules if m == module or m.startswith(f"{module}.")):
        if sys.modules[other].__dict__.get(name) is not None and (file := sys.modules[other].__file__):
            body = ast.parse(Path(file).read_text(encoding="utf-8")).body
            for first, below in pairwise(body):
                target = getattr(first, "target", None) or next(iter(getattr(first, "targets", [])), None)
                if isinstance(target, ast.Name) and target.id == name and isinstance(below, ast.Expr):
                    return inspect.cleandoc(ast.literal_eval(below.value))
    return ""


CODE = re.compile(r"(`[^`]*`)")


def on_docstring(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Docstrings are plain text with `code`."""
    lines[:] = plain_markup("\n".join(lines)).split("\n")


def plain_markup(text: str) -> str:
    """Plain text with `code` and doctests as reStructuredText: what that takes for markup of its own is escaped."""
    before, *example = text.split("\n>>>", 1)
    pieces = CODE.split(before)
    pieces[::2] = [re.sub(r"([*|])(?! )|(?<=\w)(_)(?=\W|$)", r"\\\1\2", plain) for plain in pieces[::2]]
    pieces[1::2] = [f"`{code}`" for code in pieces[1::2]]
    return "\n>>>".join(["".join(pieces), *example])
