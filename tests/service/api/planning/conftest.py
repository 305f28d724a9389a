"""A client of the whole application over the models that ship."""

from tests.service.api.v1.conftest import shipped

__all__ = ["shipped"]
