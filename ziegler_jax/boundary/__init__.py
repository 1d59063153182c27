"""Where a map's labels change: cells halved, edges halved, lines joined."""
