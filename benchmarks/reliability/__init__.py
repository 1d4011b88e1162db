"""What `kills` needs: commands of seconds, kills, and comparisons of files."""
