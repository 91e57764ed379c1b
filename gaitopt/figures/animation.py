"""The moving walker as one self-contained page: play, pause, scrub, speed; nothing is fetched from anywhere."""

from jinja2 import Environment, PackageLoader, StrictUndefined

from gaitopt.figures.film import film
from gaitopt.figures.motion import Motion


def animation_page(motion: Motion, about: str = "") -> str:
    """HTML of the walker going through several steps of ``motion``; ``about`` stands under the title."""
    templates = Environment(
        loader=PackageLoader("gaitopt.figures", "web"), autoescape=True, undefined=StrictUndefined, trim_blocks=True
    )
    templates.policies["json.dumps_kwargs"] = {"sort_keys": False, "separators": (",", ":")}
    return templates.get_template("animation.html").render(film=film(motion), about=about)
