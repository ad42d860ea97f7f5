"""The simulated EtherCAT drive, down to the bytes: controller, clock, mailbox, process data, and the cable."""
