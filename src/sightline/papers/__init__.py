"""The three published systems that Sightline rebuilds: their tables and figures beside ours."""
