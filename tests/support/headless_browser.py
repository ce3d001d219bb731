"""A page in a headless Chromium: what a reader would stumble over."""

import html
import json
import re
import shutil
import subprocess

import pytest

_FLAGS = [
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--allow-file-access-from-files",
    "--virtual-time-budget=8000", "--window-size=1400,900", "--dump-dom",
]  # fmt: skip
# Opens everything that is folded. WCAG's contrast: 4.5, or 3 for large letters.
_LOOK = """<script>
const errors = [];
addEventListener('error', event => errors.push(String(event.message || event.target.src)), true);
addEventListener('load', () => {
  document.querySelectorAll('details').forEach(one => one.open = true);
  const every = [...document.querySelectorAll('body *')];
  const channels = text => text.match(/[\\d.]+/g).map(Number);
  const light = rgb => [.2126, .7152, .0722].reduce((sum, weight, k) => {
    const c = rgb[k] / 255;
    return sum + weight * (c <= .03928 ? c / 12.92 : ((c + .055) / 1.055) ** 2.4);
  }, 0);
  const behind = one => {
    for (; one; one = one.parentElement) {
      const colour = channels(getComputedStyle(one).backgroundColor);
      if (colour.length < 4 || colour[3] > .5) return colour;
    }
    return [255, 255, 255];
  };
  const faint = one => {
    const style = getComputedStyle(one), size = parseFloat(style.fontSize);
    const [a, b] = [channels(style.color), behind(one)].map(light).sort();
    const large = size >= 24 || (size > 18.6 && style.fontWeight >= 700);
    return (b + .05) / (a + .05) < (large ? 3 : 4.5);
  };
  const scrolls = one => {
    for (one = one.parentElement; one; one = one.parentElement)
      if (getComputedStyle(one).overflowX != 'visible') return true;
    return false;
  };
  const named = one => one.tagName + ' ' + one.textContent.trim().slice(0, 40);
  const text = one => [...one.childNodes].some(node => node.nodeType == 3 && node.data.trim());
  const found = {
    wider: every.filter(one => one.getBoundingClientRect().right > innerWidth + 1 && !scrolls(one)),
    broken: [...document.images].filter(one => !one.naturalWidth),
    faint: every.filter(one => text(one) && one.getClientRects().length && faint(one)),
  };
  for (const kind in found) found[kind] = found[kind].map(named);
  parent.postMessage(JSON.stringify({...found, errors}), '*');
});
</script>"""
# A frame of any width: a window is never narrower than 500 pixels.
_FRAME = """<pre id="found"></pre><script>
addEventListener('message', event => document.getElementById('found').textContent = event.data);
</script><iframe src="page.html" style="width: {width}px; height: 800px; border: 0"></iframe>"""


def look(page, folder, width):
    """What is wider than the window, broken, too faint, or an error; skips without a Chromium."""
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        pytest.skip("no Chromium")
    (folder / "page.html").write_text(page.replace("<head>", f"<head>{_LOOK}", 1))
    (folder / "frame.html").write_text(_FRAME.format(width=width))
    words = [browser, *_FLAGS, f"--user-data-dir={folder / 'profile'}"]
    shown = subprocess.run(
        [*words, (folder / "frame.html").as_uri()], capture_output=True, text=True, timeout=120
    )
    found = re.search(r'<pre id="found">(.*?)</pre>', shown.stdout, flags=re.S)
    assert found and found[1], shown.stderr
    return json.loads(html.unescape(found[1]))
