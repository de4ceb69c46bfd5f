"""Changes of XML that keep its form."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

from lxml import etree

from fuzz.mutations import NUMBERS
from fuzz.reader import Change

LONGEST_TREE = 200
"""Elements of a file that may still grow."""


def changed_xml(attribute: Callable[[Random, str, str], str], root: str, element: str) -> Change:
    """Return a change of one to four elements: changed, moved, doubled or left out.

    Args:
        attribute: Returns a changed value of an attribute, from its name and value.
        root: Tag of the outermost element.
        element: Tag of an element that is nested deeply now and then.
    """

    def change(random: Random, name: str, content: bytes) -> bytes:
        if random.random() < 0.02:
            start, end = f"<{element} name='x'>".encode(), f"</{element}>".encode()
            deep = random.choice((100, 3000))
            return f"<{root}>".encode() + start * deep + end * deep + f"</{root}>".encode()
        try:
            tree = etree.fromstring(content)
        except (etree.XMLSyntaxError, ValueError):
            return content
        for _ in range(random.choice((1, 1, 2, 4))):
            found = [part for part in tree.iter() if isinstance(part.tag, str)]
            if len(found) < 2:
                break
            part, other = random.choice(found[1:]), random.choice(found)
            kind = random.randrange(8)
            try:
                if kind < 4 and part.attrib:
                    key = random.choice(list(part.attrib))
                    part.set(key, attribute(random, key, part.get(key, "")))
                elif kind == 4 and part.attrib:
                    del part.attrib[random.choice(list(part.attrib))]
                elif kind == 5:
                    part.getparent().remove(part)
                elif kind == 6 and len(found) < LONGEST_TREE:
                    other.append(etree.fromstring(etree.tostring(part)))
                else:
                    part.tag = random.choice([each.tag for each in found])
            except (ValueError, etree.XMLSyntaxError):
                pass
        return etree.tostring(tree)

    return change


def changed_numbers(random: Random, value: str) -> str:
    """Return a text of numbers with one of them changed, and now and then twice as many."""
    numbers = value.split() or ["0"]
    numbers[random.randrange(len(numbers))] = random.choice(NUMBERS).decode()
    return " ".join(numbers * random.choice((1, 1, 1, 2)))
