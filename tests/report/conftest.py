"""Fixtures of invented runs and of the page of them."""

import pytest

from hrl_comfort.config import ReportConfig
from hrl_comfort.report import report
from tests.report.demo import make_demo


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    return make_demo(tmp_path_factory.mktemp("runs") / "demo")


@pytest.fixture(scope="module")
def page(demo):
    return report.report(ReportConfig(run=str(demo), output=None, video=False)).read_text()
