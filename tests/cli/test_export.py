"""`sonarjax export`: a file that onnxruntime runs, and one line for what cannot be exported."""

from __future__ import annotations

import numpy as np
import pytest

onnxruntime = pytest.importorskip("onnxruntime", reason="the runtime that the files are held to is not installed")


def test_shipped_network_is_exported(command, tmp_path):
    path = tmp_path / "segmenter.onnx"
    code, out, err = command("export", "--onnx", path)
    assert (code, err) == (0, "") and str(path) in out
    session = onnxruntime.InferenceSession(str(path), providers=["CPUExecutionProvider"])
    (semantic,) = session.run(["semantic"], {"image": np.full((2, 128, 128), 0.5, np.float32)})
    assert semantic.shape == (2, 128, 128) and session.get_modelmeta().custom_metadata_map["segmenter"] == "pix2pix"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--onnx", "f.onnx", "--segmenter", "otsu"], "'otsu' has no network"),
        (
            ["--onnx", "f.onnx", "--segmenter", "unet"],
            "--segmenter: expected pix2pix or a .safetensors file, got 'unet'",
        ),
        (["--onnx", "f.onnx", "--segmenter", "none.safetensors"], "none.safetensors"),
        (["--onnx", "f.onnx", "--segmenter", "broken.safetensors"], "expected a complete safetensors file"),
        (["--onnx", "broken.safetensors", "--segmenter", "broken.safetensors"], "would overwrite the input"),
        (["--onnx", "folder.onnx"], "this is a folder"),
        (["--onnx", "f.txt"], "--onnx: expected a name that ends in .onnx, got 'f.txt'"),
        (["--onnx", "missing/f.onnx"], "cannot be written"),
        ([], "--onnx"),
    ],
)
def test_what_cannot_be_exported(complaint, tmp_path, monkeypatch, arguments, said):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.safetensors").write_bytes(b"no such file")
    (tmp_path / "folder.onnx").mkdir()
    assert said in complaint(2, "export", *arguments)
    assert sorted(p.name for p in tmp_path.rglob("*")) == ["broken.safetensors", "folder.onnx"]
    assert (tmp_path / "broken.safetensors").read_bytes() == b"no such file"
