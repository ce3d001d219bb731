"""Datasets of drawn videos."""

import pytest
from support import synthetic_videos


@pytest.fixture(scope="module")
def dataset(request, tmp_path_factory):
    """The dataset that a module's CONFIG makes, with places of points of the cloth if MARKED."""
    marked, folder = getattr(request.module, "MARKED", False), tmp_path_factory.mktemp("dataset")
    return synthetic_videos.write_dataset(request.module.CONFIG, folder, marked)
