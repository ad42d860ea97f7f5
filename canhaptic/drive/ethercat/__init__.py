"""Servo drives on EtherCAT (CoE, CiA 402) with distributed clocks."""
