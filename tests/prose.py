"""Docstrings and comments of the source tree, and how often they break the rules of plain English."""

import ast
import io
import re
import tokenize
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

RIDDLES: Final = ("whoever", "nobody", "somebody", "everybody", "nothing")
QUESTIONS: Final = ("what", "who", "whose", "where", "how", "whether", "which", "when", "why", "that", "those")
_ARTICLES: Final = ("a", "an", "the", "one", "every", "all", "each", "some", "many", "several", "two")
_WORD: Final = re.compile(r"[A-Za-z][A-Za-z'-]*")
_DIRECTIVE: Final = re.compile(r"#\s*(noqa|type:|pragma)")
_HOLDERS: Final = (ast.Module, ast.ClassDef, ast.FunctionDef, ast.AsyncFunctionDef)


@dataclass(frozen=True)
class Prose:
    """Docstrings and comments of some files."""

    docstrings: tuple[str, ...]
    comments: tuple[str, ...]

    @property
    def words(self) -> int:
        """Return the number of words."""
        return len(_WORD.findall(self.text))

    @property
    def text(self) -> str:
        """Return all of it."""
        return "\n".join((*self.docstrings, *self.comments))

    def per_thousand(self, *words: str) -> float:
        """Return how often these words occur in a thousand."""
        found = [word.lower() for word in _WORD.findall(self.text)]
        return 1000.0 * sum(found.count(word) for word in words) / max(1, len(found))

    def semicolons_per_thousand(self) -> float:
        """Return the semicolons per thousand words."""
        return 1000.0 * self.text.count(";") / max(1, self.words)

    def without_opening(self, openings: Container[str]) -> list[str]:
        """Return the docstrings that start with none of these verbs and field terms; an article may stand before."""
        return [text for text in self.docstrings if not _opens_with(text, openings)]


def read_prose(files: Sequence[Path]) -> Prose:
    """Read the docstrings and comments of Python files."""
    docstrings: list[str] = []
    comments: list[str] = []
    for path in files:
        source = path.read_text(encoding="utf-8")
        nodes = [node for node in ast.walk(ast.parse(source)) if isinstance(node, _HOLDERS)]
        docstrings += [text for node in nodes if (text := ast.get_docstring(node)) is not None]
        comments += _comments(source)
    return Prose(tuple(docstrings), tuple(comments))


def _comments(source: str) -> Iterator[str]:
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type == tokenize.COMMENT and not _DIRECTIVE.match(token.string):
            yield token.string.lstrip("# ")


def _opens_with(text: str, openings: Container[str]) -> bool:
    """Return whether the first word is one of these, or one of the first three words behind an article is."""
    words = [word.lower() for word in _WORD.findall(text.split("\n\n")[0].replace("`", ""))][:4]
    if not words or words[0] in QUESTIONS:
        return False
    if words[0] in _ARTICLES:
        words = words[1:]
    return any(_is_form_of(word, openings) for word in words[:3])


def _is_form_of(word: str, openings: Container[str]) -> bool:
    """Return whether a word is one of these, in the singular or the plural."""
    return any(form in openings for form in (word, word.removesuffix("s"), word.removesuffix("es")))
