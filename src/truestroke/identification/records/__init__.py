"""A record of voltage and displacement as it is read, and as the fit takes it."""
