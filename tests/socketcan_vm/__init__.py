"""SocketCAN in a virtual machine; see README.md."""
