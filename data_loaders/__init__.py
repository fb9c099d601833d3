"""File formats, one a file: readers and writers of measured reflectance and of our own results."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
