"""What can be wrong with a request, as classes that the callers translate into one line for the user."""


class SceneError(Exception):
    """A scene or setting that cannot be rendered: the message names the object and the way out."""
