"""Faults of a picture in which no single silhouette stands out, each with its cure."""

from service.errors import InvalidImageError


def blank(where: str) -> InvalidImageError:
    """Return the error of a picture without an object."""
    return InvalidImageError.at(
        where,
        "a blank picture (image_blank): nothing stands out from the table",
        "one object that differs from the table in brightness or colour, wholly in the picture, or its mask",
    )


def clipped(where: str) -> InvalidImageError:
    """Return the error of an object that touches the border."""
    return InvalidImageError.at(
        where,
        "a picture whose object touches the border (image_clipped)",
        "a picture that shows the whole object with some table around it",
    )


def several_objects(where: str, count: int) -> InvalidImageError:
    """Return the error of several objects of similar size."""
    return InvalidImageError.at(
        where,
        f"a picture of {count} objects (image_several_objects)",
        "a picture of one object: remove the others, crop the picture, or send a mask of one",
    )


def unclear(where: str) -> InvalidImageError:
    """Return the error of a picture whose segmentation is no plausible object."""
    return InvalidImageError.at(
        where,
        "a picture in which no single silhouette stands out",
        "an object that contrasts with a plain table in even light, or a mask of it (alpha, or black and white)",
    )
