"""Make modules in another form than their size asks for."""

from symsimpson.api import compiling as api
from symsimpson.lower import forms, module_kernels, pipeline


def limited(monkeypatch, **limits):
    """Set limits of the generator for a test; all texts are derived anew, and none is kept."""
    for name, value in limits.items():
        monkeypatch.setattr(forms if hasattr(forms, name) else module_kernels, name, value)
    anew = getattr(pipeline._derive, "__wrapped__", pipeline._derive)  # asked for once more
    monkeypatch.setattr(pipeline, "_derive", anew)
    monkeypatch.setattr(api, "_derive", pipeline.derive)
