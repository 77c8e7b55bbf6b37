#!/usr/bin/env python3
"""Opens HTML reports in headless Chromium and checks what a reader would see.

Fails (exit code 1, one line per fault) unless, in every view:
  - the file is smaller than 5 MB,
  - nothing was logged as an error and no exception was thrown,
  - no request but the one for the file itself was made or attempted,
  - every chart has a canvas, and every canvas shows something,
  - a drag across a chart zooms it (and its group), a key resets it,
  - nothing is wider than the window, on a desk and on a telephone.

Needs Python and Chromium alone (DevTools protocol over a pipe).

  screenshot_report.py [--shots DIR] [--views light,dark,narrow] REPORT.html...
"""

import argparse
import base64
import json
import os
import pathlib
import select
import shutil
import subprocess
import sys
import tempfile
import time

FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking", "--disable-component-update",
    "--disable-sync", "--no-first-run", "--disable-default-apps", "--disable-extensions", "--disable-dev-shm-usage",
    "--hide-scrollbars", "--remote-debugging-pipe",
]
MAX_BYTES = 5_000_000
# Colour scheme, width and height of the window.
VIEWS = {"light": ("light", 1360, 900), "dark": ("dark", 1360, 900), "narrow": ("light", 390, 800)}

CANVASES = """
(() => [...document.querySelectorAll("[data-chart]")].map(plot => {
  const canvas = plot.querySelector("canvas");
  if (!canvas || !canvas.width || !canvas.height) return {drawn: 0, colours: 0};
  const pixels = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  const seen = new Set();
  let drawn = 0;
  for (let i = 0; i < pixels.length; i += 4) if (pixels[i + 3] > 40) {
    drawn++;
    seen.add((pixels[i] >> 4) << 8 | (pixels[i + 1] >> 4) << 4 | pixels[i + 2] >> 4);
  }
  return {drawn: drawn / (pixels.length / 4), colours: seen.size};
}))()
"""


class Browser:
    """A headless Chromium, spoken to over file descriptors 3 and 4."""

    def __init__(self, executable, profile):
        read_here, write_there = os.pipe()
        read_there, write_here = os.pipe()

        def wire():
            # Lift both out of the way first: either could already be 3 or 4.
            a, b = os.dup2(read_there, 20), os.dup2(write_there, 21)
            os.dup2(a, 3)
            os.dup2(b, 4)

        self.process = subprocess.Popen(
            [executable, *FLAGS, f"--user-data-dir={profile}", "about:blank"],
            preexec_fn=wire, close_fds=False, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        os.close(read_there)
        os.close(write_there)
        self.reader, self.writer = read_here, write_here
        self.buffer, self.events, self.number = b"", [], 0
        target = self.call("Target.createTarget", {"url": "about:blank"})["targetId"]
        self.session = self.call("Target.attachToTarget", {"targetId": target, "flatten": True})["sessionId"]
        for domain in ("Page", "Runtime", "Log", "Network"):
            self.page(f"{domain}.enable")

    def receive(self, deadline):
        while b"\0" not in self.buffer:
            ready, _, _ = select.select([self.reader], [], [], max(0.0, deadline - time.monotonic()))
            if not ready:
                raise TimeoutError("the browser does not answer")
            chunk = os.read(self.reader, 1 << 20)
            if not chunk:
                raise EOFError("the browser has ended")
            self.buffer += chunk
        message, self.buffer = self.buffer.split(b"\0", 1)
        return json.loads(message)

    def call(self, method, params=None, session=None, timeout=60.0):
        self.number += 1
        message = {"id": self.number, "method": method, "params": params or {}}
        if session:
            message["sessionId"] = session
        data = json.dumps(message).encode() + b"\0"
        while data:
            data = data[os.write(self.writer, data):]
        deadline = time.monotonic() + timeout
        while True:
            answer = self.receive(deadline)
            if answer.get("id") == self.number:
                if "error" in answer:
                    raise RuntimeError(f"{method}: {answer['error']['message']}")
                return answer["result"]
            if "method" in answer:
                self.events.append(answer)

    def page(self, method, params=None):
        return self.call(method, params, self.session)

    def evaluate(self, expression):
        result = self.page("Runtime.evaluate", {"expression": expression, "returnByValue": True, "awaitPromise": True})
        if "exceptionDetails" in result:
            raise RuntimeError(result["exceptionDetails"].get("text", "exception") + " in " + expression[:80])
        return result["result"].get("value")

    def wait(self, expression, timeout=30.0):
        deadline = time.monotonic() + timeout
        while not self.evaluate(expression):
            if time.monotonic() > deadline:
                return False
            time.sleep(0.05)
        return True

    def close(self):
        try:
            self.call("Browser.close", timeout=10.0)
        except (EOFError, TimeoutError, BrokenPipeError, OSError):
            pass
        try:
            self.process.wait(10)
        except subprocess.TimeoutExpired:
            self.process.kill()


def show(browser, url, scheme, width, height):
    """Loads the page with every chart drawn."""
    browser.page("Emulation.setEmulatedMedia", {"features": [{"name": "prefers-color-scheme", "value": scheme}]})
    browser.page("Emulation.setDeviceMetricsOverride",
                 {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False})
    browser.events.clear()
    browser.page("Page.navigate", {"url": url})
    browser.wait("document.readyState === 'complete' && location.href !== 'about:blank'")
    browser.evaluate("document.querySelectorAll('details').forEach(d => d.open = true)")
    # A window as high as the page brings every chart near the screen.
    full = browser.evaluate("document.documentElement.scrollHeight")
    browser.page("Emulation.setDeviceMetricsOverride",
                 {"width": width, "height": int(full) + 200, "deviceScaleFactor": 1, "mobile": False})
    drawn = browser.wait("[...document.querySelectorAll('[data-chart]')].every(p => p.querySelector('canvas'))", 20.0)
    browser.evaluate("new Promise(done => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")
    return drawn


def problems_logged(browser, url):
    faults = []
    for event in browser.events:
        kind, params = event["method"], event["params"]
        if kind == "Runtime.exceptionThrown":
            details = params["exceptionDetails"]
            faults.append("exception: " + details.get("exception", {}).get("description", details["text"])[:200])
        elif kind == "Runtime.consoleAPICalled" and params["type"] in ("error", "assert"):
            faults.append("console error: " + json.dumps(params["args"])[:200])
        elif kind == "Log.entryAdded" and params["entry"]["level"] == "error":
            faults.append("log error: " + params["entry"]["text"][:200])
        elif kind == "Network.requestWillBeSent":
            asked = params["request"]["url"]
            if asked != url and not asked.startswith(("data:", "about:")):
                faults.append("request: " + asked[:200])
    return faults


def canvases(browser):
    faults = []
    for index, canvas in enumerate(browser.evaluate(CANVASES)):
        # Axes and grid alone use about two greys; a curve adds its own colour.
        if canvas["drawn"] < 0.005 or canvas["colours"] < 4:
            faults.append(f"chart {index} is empty: {canvas}")
    return faults


def zoom(browser):
    """Drags across the first chart that shares its zoom, then resets by keyboard."""
    browser.evaluate("""document.querySelector('[data-chart]').scrollIntoView({block: 'center', behavior: 'instant'})""")
    box = browser.evaluate("""(() => { const r = document.querySelector('[data-chart] .u-over').getBoundingClientRect();
        return [r.left, r.top, r.width, r.height]; })()""")
    y = box[1] + box[3] / 2
    scale = "(() => { const s = document.querySelector('[data-chart]').chart.scales.x; return [s.min, s.max]; })()"
    before = browser.evaluate(scale)
    for kind, share in (("mouseMoved", 0.3), ("mousePressed", 0.3), ("mouseMoved", 0.5), ("mouseMoved", 0.6), ("mouseReleased", 0.6)):
        browser.page("Input.dispatchMouseEvent", {"type": kind, "x": box[0] + share * box[2], "y": y,
                     "button": "none" if kind == "mouseMoved" and share == 0.3 else "left", "buttons": 1, "clickCount": 1})
    browser.evaluate("new Promise(done => setTimeout(done, 100))")
    inside = browser.evaluate(scale)
    width = before[1] - before[0]
    if abs((inside[1] - inside[0]) / width - 0.3) > 0.05:
        return [f"a drag over 30 % of the first chart zoomed {before} to {inside}"]
    browser.evaluate("document.querySelector('[data-chart]').focus()")
    browser.page("Input.dispatchKeyEvent", {"type": "keyDown", "key": "0", "text": "0"})
    browser.page("Input.dispatchKeyEvent", {"type": "keyUp", "key": "0"})
    browser.evaluate("new Promise(done => setTimeout(done, 100))")
    after = browser.evaluate(scale)
    return [] if after == before else [f"key 0 left the zoom at {after}, not {before}"]


def shot(browser, path):
    data = browser.page("Page.captureScreenshot", {"format": "png", "captureBeyondViewport": True})["data"]
    path.write_bytes(base64.b64decode(data))


def check(browser, report, views, shots):
    faults = []
    size = report.stat().st_size
    if size >= MAX_BYTES:
        faults.append(f"{size} bytes, expected fewer than {MAX_BYTES}")
    url = report.resolve().as_uri()
    for name in views:
        scheme, width, height = VIEWS[name]
        found = []
        if not show(browser, url, scheme, width, height):
            found.append("a chart was not drawn")
        charts = browser.evaluate("document.querySelectorAll('[data-chart]').length")
        if charts == 0:
            found.append("no charts")
        else:
            found += canvases(browser)
            if not found and name == "light":
                found += zoom(browser)
        wide = browser.evaluate("document.documentElement.scrollWidth")
        if wide > width:
            found.append(f"page is {wide} px wide in a window of {width} px")
        found += problems_logged(browser, url)
        if shots:
            shot(browser, shots / f"{report.stem}-{name}.png")
        faults += [f"{name}: {fault}" for fault in found]
    if shots:
        browser.page("Emulation.clearDeviceMetricsOverride")
        pdf = browser.page("Page.printToPDF", {"printBackground": False, "preferCSSPageSize": True})["data"]
        (shots / f"{report.stem}.pdf").write_bytes(base64.b64decode(pdf))
    if not faults:
        print(f"{report.name}: {charts} charts, {size / 1e6:.2f} MB, no errors, no requests")
    return faults


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--shots", type=pathlib.Path, help="directory for screenshots and a printed PDF")
    parser.add_argument("--views", default=",".join(VIEWS), help="which of " + ", ".join(VIEWS))
    parser.add_argument("--chromium", default="chromium")
    parser.add_argument("reports", nargs="+", type=pathlib.Path)
    args = parser.parse_args()
    executable = shutil.which(args.chromium)
    if not executable:
        print(f"{args.chromium} is not on PATH", file=sys.stderr)
        return 2
    if args.shots:
        args.shots.mkdir(parents=True, exist_ok=True)
    failed = False
    with tempfile.TemporaryDirectory(prefix="lacuna-chromium-", ignore_cleanup_errors=True) as profile:
        browser = Browser(executable, profile)
        try:
            for report in args.reports:
                for fault in check(browser, report, args.views.split(","), args.shots):
                    failed = True
                    print(f"{report.name}: {fault}", file=sys.stderr)
        finally:
            browser.close()
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
