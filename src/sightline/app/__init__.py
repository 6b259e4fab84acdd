"""Page in the browser on which sensors are broken and predictions watched (`sightline serve`)."""
