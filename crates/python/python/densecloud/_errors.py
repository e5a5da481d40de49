"""What can go wrong, and what a person should know."""


class DensecloudError(Exception):
    """The work failed: ONNX Runtime or a model cannot be loaded, a folder of tiles is broken."""


class InvalidInputError(DensecloudError, ValueError):
    """A cloud, an option or a file that cannot be worked on; says what is wrong with it, and what it may be."""


class DensecloudWarning(UserWarning):
    """What a person should know about how a cloud was read, made dense or written."""


for _public in (DensecloudError, InvalidInputError, DensecloudWarning):
    _public.__module__ = "densecloud"
