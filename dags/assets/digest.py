"""The digest of models and weights, and of the code that runs them where it is no part of a stage's kernel."""

from __future__ import annotations

from typing import Any

from posegaussian.dags.provenance.code_digest import code_digest
from posegaussian.dags.provenance.once import once
from posegaussian.stages.contract.declaration import Asset
from posegaussian.storage.model.spec import digest


def asset_digest(asset: Asset, settings: Any) -> str:
    """Digest of what a kernel would get of an asset under its settled settings."""
    contents = asset.digest(settings)
    if asset.code is None:
        return contents
    module = asset.code(settings)
    return digest([contents, once(("code", module), lambda: code_digest(module))])
