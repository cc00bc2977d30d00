"""The one style of all charts."""
