"""jaxbrdf: differentiable reflectance models, fitted to measurements.

The names below are loaded on first use, so that importing the package costs nothing; __init__.pyi is
the table of contents.
"""

import lazy_loader

__version__ = "0.1.0"

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
