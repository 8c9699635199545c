"""Check in a browser that no page of the built documentation is wider than the screen.

``python docs/pictures/pages.py BUILT`` opens every page of the folder at 1400 and at 400 pixels. On a wide screen no
code and no table may need a scroll bar; on a phone they may, but the page itself may not. ``--out FOLDER`` also writes
pictures of the main pages. It needs Chromium, and reports when there is none.
"""

import argparse
import shutil
import sys
from pathlib import Path

MAIN = (
    "index", "start/five-minutes", "start/which-parts", "tutorials/first-vector", "how-to/index",
    "how-to/segment-by-clicking", "concepts/validity", "concepts/what-can-go-wrong", "reference/configuration",
    "reference/cli/deploy", "reference/api/wrappers", "benchmarks/index", "benchmarks/speed", "examples",
)  # fmt: skip
WIDTHS = {1400: "pre, .table-wrapper", 400: ""}
WIDER = r"""selector => {
    const shown = element => (element.innerText || element.className).trim().split("\n", 1)[0].slice(0, 60);
    const wide = [...(selector ? document.querySelectorAll(selector) : [])]
        .filter(element => element.scrollWidth > element.clientWidth + 1)
        .map(element => `${element.scrollWidth - element.clientWidth} px too wide: ${shown(element)}`);
    const page = document.documentElement;
    if (page.scrollWidth > window.innerWidth + 1) wide.push(`the page is ${page.scrollWidth} px wide`);
    return wide;
}"""


def main() -> int:
    """Open all pages, print what is too wide, and return 1 if anything is."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("built", type=Path, help="folder that sphinx-build wrote")
    parser.add_argument("--out", type=Path, help="folder for pictures of the main pages")
    arguments = parser.parse_args()
    chromium = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if chromium is None:
        print("No Chromium is installed: the widths of the pages are not checked.")
        return 0
    from playwright.sync_api import sync_playwright

    left_out = ("genindex", "py-modindex", "search")
    pages = [
        page for page in sorted(arguments.built.rglob("*.html"))
        if "_modules" not in page.parts and page.stem not in left_out
    ]  # fmt: skip
    found = 0
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        for width, selector in WIDTHS.items():
            view = browser.new_page(viewport={"width": width, "height": 900})
            for path in pages:
                name = path.relative_to(arguments.built).with_suffix("").as_posix()
                view.goto(path.resolve().as_uri())
                for wide in view.evaluate(WIDER, selector):
                    found += 1
                    print(f"{name} at {width} px: {wide}")
                if arguments.out and name in MAIN:
                    arguments.out.mkdir(parents=True, exist_ok=True)
                    view.screenshot(path=arguments.out / f"{name.replace('/', '_')}_{width}.png", full_page=True)
        browser.close()
    print(f"{len(pages)} pages, {found} places that are too wide")
    return int(found > 0)


if __name__ == "__main__":
    sys.exit(main())
