"""Implement camera protocols: HTTP, MJPEG, RTSP, folders and lists, with exposure times and directions."""
