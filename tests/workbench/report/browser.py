"""A headless Chromium that opens a page, runs a few lines in it and says what they found."""

import html
import json
import re
import shutil
import subprocess
from pathlib import Path

CHROMIUM = next((found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None)
FLAGS = ("--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking", "--hide-scrollbars")


def asked(page: Path, lines: str, *, width: int = 1200, dark: bool = False, budget: int = 4000) -> dict:
    """What `lines` (the body of a function that returns plain values) says in the page, and the errors of the page's scripts."""
    assert CHROMIUM is not None
    text = page.read_text(encoding="utf-8")
    listen = (
        "<script>window.__errors = []; window.onerror = m => { window.__errors.push(String(m)); };"
        "document.addEventListener('securitypolicyviolation', e => window.__errors.push('refused ' + e.blockedURI));</script>"
    )
    ask = (
        "<script>setTimeout(() => { let found; try { found = (() => {"
        + lines
        + "})(); } catch (e) { window.__errors.push(String(e)); }"
        "const out = document.createElement('pre'); out.id = 'asked';"
        "out.textContent = JSON.stringify({found, errors: window.__errors});"
        "document.body.replaceChildren(out); }, 300);</script>"
    )
    opened = page.with_name(f"asked-{page.name}")
    opened.write_text(text.replace("<head>", "<head>" + listen, 1).replace("</body>", ask + "</body>"), encoding="utf-8")
    words = [CHROMIUM, *FLAGS, f"--user-data-dir={page.parent / 'chromium'}", f"--window-size={width},900"]
    words += ["--blink-settings=preferredColorScheme=0"] if dark else []
    words += [f"--virtual-time-budget={budget}", "--dump-dom", opened.absolute().as_uri()]
    done = subprocess.run(words, capture_output=True, text=True, timeout=120, check=True)
    found = re.search(r'<pre id="asked">(.*?)</pre>', done.stdout, re.DOTALL)
    assert found, done.stderr[-2000:]
    return json.loads(html.unescape(found[1]))
