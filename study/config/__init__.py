"""Settings. Importing the package registers the sections of the study's own models."""

from study.config import model_sections

__all__ = ["model_sections"]
