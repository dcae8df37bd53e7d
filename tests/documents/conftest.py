"""The tests of this folder need the reference documents."""

from __future__ import annotations

import pytest
from tests.documents.reading import available


def pytest_collection_modifyitems(items):
    if not available():
        skip = pytest.mark.skip(reason="the reference documents are in ../shared/seeds")
        for item in items:
            if "documents" in item.path.parts:
                item.add_marker(skip)
