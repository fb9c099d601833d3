"""Fits of models to measurements: batched Levenberg–Marquardt, and the recipes built on it."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
