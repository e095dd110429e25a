"""A headless Chromium for tests that look at a page, or the reason why there is none."""

import contextlib
import os
import shutil
from collections.abc import Iterator
from typing import Any

import pytest

# Where a distribution, or the variable, puts it; Playwright's own download is the last resort.
NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")
# It must ask nothing of any network, and run as root in a container.
FLAGS = ["--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking",
         "--disable-component-update", "--disable-sync", "--disable-quic"]  # fmt: skip


@contextlib.contextmanager
def chromium() -> Iterator[Any]:
    """A running browser of Playwright; skips the test, with the reason, where there is none."""
    playwright = pytest.importorskip("playwright.sync_api", reason="needs Playwright: pip install playwright")
    binary = os.environ.get("CHROMIUM") or next(filter(None, map(shutil.which, NAMES)), None)
    with playwright.sync_playwright() as driver:
        try:
            browser = driver.chromium.launch(executable_path=binary, args=FLAGS)
        except playwright.Error as error:
            pytest.skip(f"no Chromium could be started (apt-get install chromium, or set CHROMIUM): {error}")
        yield browser
        browser.close()
