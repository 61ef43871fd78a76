"""The identified model in the manners of other packages; each module needs the extra that is named after it."""
