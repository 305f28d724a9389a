"""Registry of a command, opened as the settings of the service say: sizes, cache and, where it matters, signatures."""

from service.cli.configuration import configure
from service.registry.location import open_registry, trusted_keys
from service.registry.registry import Registry


def open_as_served(location: str) -> Registry:
    """Open a registry as the service does: it accepts the versions that the service would serve, and no others.

    Raises:
        SettingsError: a setting of the service is unknown or invalid.
        RegistryError: the location is not that of a registry, a trusted key cannot be read, or an extra is missing.
    """
    settings = configure({}).settings
    keys = trusted_keys(settings.require_signature)
    return open_registry(location, keys, settings.max_model_bytes, settings.cache)


def open_unsigned(location: str) -> Registry:
    """Open a registry as the service does, but accept versions without a signature: to list, show, sign and copy them.

    Raises:
        SettingsError, RegistryError: see ``open_as_served``.
    """
    settings = configure({}).settings
    return open_registry(location, None, settings.max_model_bytes, settings.cache)
