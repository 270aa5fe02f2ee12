"""What cameras speak: HTTP, MJPEG, RTSP, folders and lists, with exposure times and directions."""
