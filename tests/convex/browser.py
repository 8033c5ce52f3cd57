"""What a headless browser shows."""

from __future__ import annotations

import base64
import itertools
import json
import subprocess
import time
import urllib.request
from collections.abc import Iterator
from io import BytesIO
from pathlib import Path

import numpy as np
from PIL import Image
from websockets.sync.client import connect

__all__ = ["screenshots"]


def screenshots(address: str, profile: Path, seconds: float) -> Iterator[np.ndarray]:
    """What Chromium shows at an address, again and again (by its DevTools protocol)."""
    browser = subprocess.Popen(
        ["chromium", "--headless", "--no-sandbox", "--window-size=800,600", "--use-gl=angle",
         "--use-angle=swiftshader", "--enable-unsafe-swiftshader", f"--user-data-dir={profile}",
         "--remote-debugging-port=0", address],
        stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
    )  # fmt: skip
    end = time.monotonic() + seconds
    try:
        told = profile / "DevToolsActivePort"
        while not (told.is_file() and told.read_text().count("\n")) and time.monotonic() < end:
            time.sleep(0.2)
        port = told.read_text().split()[0]
        with urllib.request.urlopen(f"http://127.0.0.1:{port}/json") as answer:
            page = next(one for one in json.load(answer) if one["type"] == "page")
        with connect(page["webSocketDebuggerUrl"], max_size=None) as socket:
            for number in itertools.count(1):
                socket.send(json.dumps({"id": number, "method": "Page.captureScreenshot"}))
                while (reply := json.loads(socket.recv())).get("id") != number:
                    pass
                yield np.asarray(Image.open(BytesIO(base64.b64decode(reply["result"]["data"]))).convert("RGB"))
                if time.monotonic() > end:
                    return
                time.sleep(0.5)
    finally:
        browser.terminate()
        browser.wait()
