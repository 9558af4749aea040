"""What every layer uses: optional packages, atomic files, random states, schemas of files."""
