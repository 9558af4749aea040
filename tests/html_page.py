"""A page as a browser reads it: elements, text, and the figures that it unpacks."""

import json
import re
import zlib
from html.parser import HTMLParser

VOID = {"meta", "link", "br", "img", "input", "hr"}
# Signs in which the page writes bytes: 13 bits in two of them.
SIGNS = [chr(code) for code in range(33, 127) if chr(code) not in "'<\\"]


class Page(HTMLParser):
    """Elements with their attributes, text by element, and errors of nesting."""

    def __init__(self, text):
        super().__init__()
        self.open = []
        self.elements = []
        self.texts = []
        self.errors = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag):
        if not self.open or self.open.pop() != tag:
            self.errors.append(tag)

    def handle_data(self, data):
        self.texts.append((self.open[-1] if self.open else "", data))

    @property
    def is_well_formed(self):
        return not self.errors and not self.open

    @property
    def tags(self):
        return [tag for tag, _ in self.elements]

    @property
    def ids(self):
        return [attrs["id"] for _, attrs in self.elements if "id" in attrs]

    @property
    def text(self):
        """What is read, on one line."""
        parts = [data for tag, data in self.texts if tag not in ("script", "style")]
        return re.sub(r"\s+", " ", " ".join(parts))

    def all(self, tag):
        """Attributes of all elements of a kind."""
        return [attrs for other, attrs in self.elements if other == tag]

    def of_class(self, name):
        """Attributes of all elements of a class."""
        every = [attrs for _, attrs in self.elements]
        return [attrs for attrs in every if name in attrs.get("class", "").split()]


def figures(text):
    """The figures of a page by name, unpacked as its script does."""
    pattern = r'<script type="text/plain" id="figures" data-size="(\d+)">(.*?)</script>'
    size, packed = re.search(pattern, text).groups()
    value = {sign: number for number, sign in enumerate(SIGNS)}
    bits = ""
    for first, second in zip(packed[::2], packed[1::2]):
        bits += f"{len(SIGNS) * value[first] + value[second]:013b}"
    n_bytes = int(size)
    deflated = int(bits[: 8 * n_bytes], 2).to_bytes(n_bytes)
    return json.loads(zlib.decompress(deflated))


def traces(text):
    """All traces of all figures of a page."""
    return [trace for figure in figures(text).values() for trace in figure["data"]]
