"""The folder that qudi is given as one of its `extension_paths`; its name is printed by running this package."""
