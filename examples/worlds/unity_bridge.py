"""A game engine behind a rig: Unity, Unreal, Godot or your own, which speaks JSON over UDP. Not run with Unity.

Each frame the game sends {"wall": 0.03, "speed": 0.0, "pushes": "-", "work": 0.001} to port 5600 ("wall": null: free)
and gets back {"x": 0.012, "v": 0.1}. "work" is what the hand did on the game's bodies since the last frame [J]. In C#:

    client.Send(Encoding.UTF8.GetBytes(JsonUtility.ToJson(frame)));      // UdpClient, connected to 127.0.0.1:5600
    while (client.Available > 0) hand = JsonUtility.FromJson<Hand>(Encoding.UTF8.GetString(client.Receive(ref from)));
"""

import json
import socket
import sys
from pathlib import Path

import canhaptic

RIG = Path(__file__).resolve().parents[2] / "configs" / "far_world.yaml"

if __name__ == "__main__":
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as game:
        game.bind(("127.0.0.1", 5600))
        game.setblocking(False)
        with canhaptic.World((sys.argv[1:] or ["loopback"])[0], scene=RIG) as world:
            for hand in world:  # a turn for each SYNC of the rig that has come; the game may be as slow as it is
                try:
                    text, sender = game.recvfrom(4096)
                except BlockingIOError:
                    continue
                frame, axis, now = json.loads(text), world["handle"], hand["handle"]
                axis.absorbed(frame.get("work", 0.0))
                if frame["wall"] is None:
                    axis.free()
                else:
                    axis.wall(frame["wall"], 2000.0, frame["pushes"], frame.get("speed", 0.0), damping=5.0)
                game.sendto(json.dumps({"x": now.position, "v": now.velocity}).encode(), sender)
