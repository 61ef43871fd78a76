"""The controller: settings, adaptation laws, the NumPy text, the kernel."""
